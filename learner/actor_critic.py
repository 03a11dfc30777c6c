"""pi_theta(a | s, g): an entropy-regularised actor-critic, corrected for rollouts of an older policy."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import PolicyConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.action_batch import ActionBatch, join, random_logp
from giirl_core.nets.batch import Batch
from giirl_core.nets.models import PolicyNet
from learner.data import Example, collate_steps, pad, sampled_of, steps_of
from learner.losses import vtrace

MAX_GRAD_NORM = 1.0


class ActorCritic:
    """Maximises eq. 3.1, E[sum gamma^(t-1) r_t + alpha H(pi)], with two gradients on the states that rollouts visit.

    V-trace policy gradients on the actions taken; and, since a learned reward also scores actions that were not taken,
    a step towards p(a) ~ exp(r(s, a | g) / alpha), the soft-optimal choice for the immediate reward, among M sampled
    actions, half of them the policy's and half uniform. The first sees consequences. The second does not, but cannot
    get stuck: a policy that never types still learns which typing the reward favours.
    """

    def __init__(self, config: PolicyConfig, net: PolicyNet, *, metrics: Metrics) -> None:
        self.config, self.net, self._metrics = config, net, metrics
        self.optimiser = torch.optim.Adam(net.parameters(), lr=config.learning_rate, fused=True)
        self.entropy = config.entropy  # alpha as it is now

    def update(self, rollouts: Sequence[Example], rewards: Sequence[Tensor]) -> dict[str, float]:
        """Policy-optimisation steps on rollouts and their rewards.

        Each of `rewards` is [T, 1 + M]: of the action taken and of the M sampled ones; M may be 0.
        """
        batch, taken = collate_steps(steps_of(rollouts))
        sampled, drawn_logp = sampled_of(rollouts)
        lengths = [len(example.features) for example in rollouts]
        mask = torch.arange(max(lengths)) < torch.tensor(lengths).unsqueeze(1)
        behaviour = torch.from_numpy(pad([example.trajectory.behaviour_logp for example in rollouts]))
        proposal = torch.logaddexp(drawn_logp, random_logp(batch, sampled))  # half the policy's, half uniform
        device = self.net.device
        pages, actions, paid = batch.to(device), join(taken, sampled).to(device), torch.cat(list(rewards)).to(device)
        behaviour, proposal, mask = behaviour.to(device), proposal.to(device), mask.to(device)
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            with timed_update(self._metrics, "policy"):
                stats = self._descend(pages, actions, paid, behaviour, proposal, mask)
        return stats

    def _descend(
        self, batch: Batch, actions: ActionBatch, rewards: Tensor, behaviour: Tensor, proposal: Tensor, mask: Tensor
    ) -> dict[str, float]:
        """One step; actions and rewards are [sum T, 1 + M], behaviour and mask [episodes, T], proposal [sum T, M]."""
        seen = self.net.encoder(batch)
        logp, entropy = self.net.evaluate(seen, actions)
        value = self.net.state_value(seen)
        now, values = _by_episode(logp[:, 0].detach(), mask), _by_episode(value.detach(), mask)
        paid = _by_episode(rewards[:, 0], mask)
        ahead = functional.pad(_by_episode(entropy.detach(), mask)[:, 1:], (0, 1))
        soft = paid + self.config.gamma * self.entropy * ahead
        targets, advantages = vtrace(now, behaviour, soft, values, mask, self.config.gamma)
        gain = (advantages[mask] * logp[:, 0]).mean()
        distance = -(soft_optimal(rewards[:, 1:], proposal, self.entropy) * logp[:, 1:]).sum(1).mean()
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


def soft_optimal(rewards: Tensor, proposal: Tensor, alpha: float) -> Tensor:
    """[B, M] p(a) ~ exp(r(a) / alpha) among M actions that were drawn with log-probabilities `proposal`, nats."""
    return (rewards / alpha - proposal).softmax(1)


def descend(optimiser: torch.optim.Optimizer, net: nn.Module, loss: Tensor) -> None:
    """One optimiser step with the gradient's norm bounded."""
    optimiser.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(net.parameters(), MAX_GRAD_NORM)
    optimiser.step()


def _by_episode(flat: Tensor, mask: Tensor) -> Tensor:
    """[B, T] from the [sum T] of all steps in order."""
    table = torch.zeros(mask.shape, device=flat.device)
    table[mask] = flat
    return table
