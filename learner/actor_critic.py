"""pi_theta(a | s, g): an entropy-regularised actor-critic, corrected for rollouts of an older policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import PolicyConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.features import ActionBatch, Batch
from giirl_core.nets.models import PolicyNet
from giirl_core.types import Verb
from learner.data import Example, collate_steps, pad, steps_of
from learner.losses import vtrace

MAX_GRAD_NORM = 1.0

RewardFn = Callable[[Batch, ActionBatch], Tensor]  # r(s, a | g) [B, M]


class ActorCritic:
    """Maximises eq. 3.1, E[sum gamma^(t-1) r_t + alpha H(pi)], with two gradients on the states that rollouts visit.

    V-trace policy gradients on the actions taken; and since a learned reward can be asked about actions that
    nobody took, a step towards p(a) ~ exp(r(s, a | g) / alpha), the soft-optimal choice for the immediate reward,
    among `asked` actions, half of them the policy's and half chance. The first sees consequences, the second does
    not, but cannot get stuck: a policy that never types still learns what the reward would like to see typed.
    """

    def __init__(self, config: PolicyConfig, net: PolicyNet, generator: torch.Generator, *, metrics: Metrics) -> None:
        self.config, self.net, self._generator, self._metrics = config, net, generator, metrics
        self.optimiser = torch.optim.Adam(net.parameters(), lr=config.learning_rate)
        self.entropy = config.entropy  # alpha as it is now

    def update(
        self, rollouts: Sequence[Example], rewards: Sequence[Tensor], reward_fn: RewardFn | None
    ) -> dict[str, float]:
        """Policy-optimisation steps on the `rewards` [T] of the rollouts; `reward_fn` is None where the reward of what
        nobody did is not to be had."""
        batch, taken = collate_steps(steps_of(rollouts))
        lengths = [len(example.features) for example in rollouts]
        mask = torch.arange(max(lengths)) < torch.tensor(lengths).unsqueeze(1)
        behaviour = torch.from_numpy(pad([example.trajectory.behaviour_logp for example in rollouts]))
        paid = torch.from_numpy(pad([reward.numpy() for reward in rewards]))
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            with timed_update(self._metrics, "policy"):
                stats = self._descend(batch, taken, paid, behaviour, mask, reward_fn)
        return stats

    def _descend(
        self,
        batch: Batch,
        taken: ActionBatch,
        paid: Tensor,
        behaviour: Tensor,
        mask: Tensor,
        reward_fn: RewardFn | None,
    ) -> dict[str, float]:
        """One step on the taken and asked actions; paid, behaviour and mask are [episodes, T]."""
        actions, target = self._sample_targets(batch, taken, reward_fn)
        logp, entropy, value = self.net.evaluate(batch, actions)
        now, values = _by_episode(logp[:, 0].detach(), mask), _by_episode(value.detach(), mask)
        ahead = functional.pad(_by_episode(entropy.detach(), mask)[:, 1:], (0, 1))
        soft = paid + self.config.gamma * self.entropy * ahead
        targets, advantages = vtrace(now, behaviour, soft, values, mask, self.config.gamma)
        gain = (advantages[mask] * logp[:, 0]).mean()
        distance = -(target * logp[:, 1:]).sum(1).mean()
        error = (targets[mask] - value).pow(2).mean()
        loss = -self.config.vtrace_weight * gain + distance
        loss = loss - self.entropy * entropy.mean() + self.config.value_loss_weight * error
        descend(self.optimiser, self.net, loss)
        return {
            "p_entropy": entropy.mean().item(),
            "p_distance": distance.item(),
            "p_value_error": error.item(),
            "p_reward": paid.sum(1).mean().item(),
            "p_ratio": (now[mask] - behaviour[mask]).exp().mean().item(),
        }

    @torch.no_grad()
    def _sample_targets(
        self, batch: Batch, taken: ActionBatch, reward_fn: RewardFn | None
    ) -> tuple[ActionBatch, Tensor]:
        """The action taken and `asked` others on every page [B, 1 + M], and the soft-optimal choice among those [B, M].

        Actions come from q, half policy and half chance, so each counts with exp(r / alpha) / q.
        """
        count = self.config.sampled_actions
        if reward_fn is None or not count:
            return taken, torch.zeros(len(batch), 0)
        flat = torch.arange(count) % 2 == 1
        uniform = torch.rand(len(batch), count, 3, generator=self._generator)
        drawn, _ = self.net.sample(batch, uniform, flat)
        logp, _, _ = self.net.evaluate(batch, drawn)
        q = torch.logaddexp(logp, random_logp(batch, drawn))
        target = (reward_fn(batch, drawn) / self.entropy - q).softmax(1)
        return join(taken, drawn), target


def descend(optimiser: torch.optim.Optimizer, net: nn.Module, loss: Tensor) -> None:
    """One optimiser step with the gradient's norm bounded."""
    optimiser.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(net.parameters(), MAX_GRAD_NORM)
    optimiser.step()


def random_logp(batch: Batch, actions: ActionBatch) -> Tensor:
    """[B, M] log-probability of actions drawn uniformly: a legal pair, a first word, a last word not before it."""
    pairs = (batch.clickable.sum(1) + batch.typable.sum(1)).unsqueeze(1).float()
    words = batch.token_mask.sum(1, keepdim=True).float()
    copied = words.log() + (words - actions.start.clamp(min=0)).log()
    return -pairs.log() - torch.where(actions.verb == Verb.TYPE, copied, 0.0)


def join(taken: ActionBatch, others: ActionBatch) -> ActionBatch:
    """[B, 1 + M]: the action taken, then the others."""
    return ActionBatch(
        verb=torch.cat([taken.verb, others.verb], dim=1),
        element=torch.cat([taken.element, others.element], dim=1),
        start=torch.cat([taken.start, others.start], dim=1),
        end=torch.cat([taken.end, others.end], dim=1),
    )


def _by_episode(flat: Tensor, mask: Tensor) -> Tensor:
    """[B, T] from the [sum T] of all steps in order."""
    table = torch.zeros(mask.shape)
    table[mask] = flat
    return table
