"""The policy update: an entropy-regularised actor-critic with off-policy correction for rollouts of older policies."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import PolicyConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.action_batch import ActionBatch, join, random_logp
from giirl_core.nets.batch import Batch
from giirl_core.nets.models import PolicyNet
from learner.data import Example, collate_steps, pad_rows, sampled_actions_of, steps_of
from learner.losses import vtrace

MAX_GRAD_NORM = 1.0


class ActorCritic:
    """Maximises E[sum_t gamma^(t-1) r_t + alpha H(pi)] (eq. 3.1 of Luo 2019) with two gradients on visited states.

    1. V-trace policy gradients on the actions taken (Espeholt et al. 2018). They account for later consequences.
    2. A step towards the soft-optimal policy for the immediate reward, p(a) ~ exp(r(s, a | g) / alpha), among M sampled
       actions: half from the policy, half uniform. This is possible because a learned reward also scores actions that
       were not taken. It ignores consequences, but it cannot get stuck: a policy that never types still learns which
       typing the reward favours.

    With a cloned prior pi_0 the objective is E[sum_t gamma^(t-1) r_t - alpha KL(pi || pi_0)]. That is the objective
    above with the reward r + alpha log pi_0(a | s, g).
    """

    def __init__(self, config: PolicyConfig, net: PolicyNet, *, metrics: Metrics) -> None:
        self.config, self.net, self._metrics = config, net, metrics
        self.optimiser = torch.optim.Adam(net.parameters(), lr=config.learning_rate, fused=True)
        self.entropy = config.entropy  # the current alpha
        self.frozen = False  # train the value alone
        self.prior = copy_net(net) if config.prior == "clone" else None

    def update(self, rollouts: Sequence[Example], rewards: Sequence[Tensor]) -> dict[str, float]:
        """Gradient steps on rollouts. Returns the statistics of the last step.

        Each of `rewards` is [T, 1 + M]: the reward of the action taken, then of the M sampled ones. M may be 0.
        """
        batch, taken = collate_steps(steps_of(rollouts))
        sampled, sampled_logp = sampled_actions_of(rollouts)
        lengths = [len(example.features) for example in rollouts]
        mask = torch.arange(max(lengths)) < torch.tensor(lengths).unsqueeze(1)
        behaviour_logp = torch.from_numpy(pad_rows([example.trajectory.behaviour_logp for example in rollouts]))
        # Unnormalised log-density of the sampling distribution, half policy and half uniform.
        proposal = torch.logaddexp(sampled_logp, random_logp(batch, sampled, self.net.gestures))
        device = self.net.device
        batch, actions = batch.to(device), join(taken, sampled).to(device)
        flat_rewards = torch.cat(list(rewards)).to(device)
        taken_reward = flat_rewards[:, 0].sum().item() / len(rollouts)
        if self.prior is not None:
            flat_rewards = flat_rewards + self.entropy * log_density(self.prior, batch, actions)
        behaviour_logp, proposal, mask = behaviour_logp.to(device), proposal.to(device), mask.to(device)
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            with timed_update(self._metrics, "policy"):
                stats = self._train_batch(batch, actions, flat_rewards, behaviour_logp, proposal, mask)
        return {**stats, "p_reward": taken_reward}

    def _train_batch(
        self,
        batch: Batch,
        actions: ActionBatch,  # [sum T, 1 + M]
        rewards: Tensor,  # [sum T, 1 + M]
        behaviour_logp: Tensor,  # [episodes, T]
        proposal: Tensor,  # [sum T, M]
        mask: Tensor,  # [episodes, T]
    ) -> dict[str, float]:
        encoding = self.net.encoder(batch)
        logp, entropy = self.net.evaluate(encoding, actions)
        if self.frozen:
            encoding = replace(encoding, summary=encoding.summary.detach())
        value = self.net.state_value(encoding)
        current_logp, values = _by_episode(logp[:, 0].detach(), mask), _by_episode(value.detach(), mask)
        taken_rewards = _by_episode(rewards[:, 0], mask)
        next_entropy = functional.pad(_by_episode(entropy.detach(), mask)[:, 1:], (0, 1))
        soft_rewards = taken_rewards + self.config.gamma * self.entropy * next_entropy
        targets, advantages = vtrace(current_logp, behaviour_logp, soft_rewards, values, mask, self.config.gamma)
        objective = (advantages[mask] * logp[:, 0]).mean()
        cross_entropy = -(soft_optimal(rewards[:, 1:], proposal, self.entropy) * logp[:, 1:]).sum(1).mean()
        value_error = (targets[mask] - value).pow(2).mean()
        loss = self.config.value_loss_weight * value_error
        if not self.frozen:
            loss = loss - self.config.vtrace_weight * objective + cross_entropy - self.entropy * entropy.mean()
        gradient_step(self.optimiser, self.net, loss)
        return {
            "p_entropy": entropy.mean().item(),
            "p_distance": cross_entropy.item(),
            "p_value_error": value_error.item(),
            "p_ratio": (current_logp[mask] - behaviour_logp[mask]).exp().mean().item(),
        }


def soft_optimal(rewards: Tensor, proposal: Tensor, alpha: float) -> Tensor:
    """[B, M] the distribution p(a) ~ exp(r(a) / alpha), estimated on M sampled actions by importance weights.

    `rewards` [B, M] are those of the actions. `proposal` [B, M] is the log-density, nats, of the distribution that they
    were sampled from; it need not be normalised.
    """
    return (rewards / alpha - proposal).softmax(1)


def copy_net(net: PolicyNet) -> PolicyNet:
    """A copy without gradients. It shares the word vectors."""
    return copy.deepcopy(net, {id(net.encoder.table): net.encoder.table}).requires_grad_(False)


@torch.no_grad()
def log_density(net: PolicyNet, batch: Batch, actions: ActionBatch) -> Tensor:
    """log pi(a | s, g) of `actions` [B, M], nats."""
    logp: Tensor = net.evaluate(net.encoder(batch), actions)[0]
    return logp


def gradient_step(optimiser: torch.optim.Optimizer, net: nn.Module, loss: Tensor) -> None:
    """One optimiser step on `loss`, with the norm of the gradient clipped at MAX_GRAD_NORM."""
    optimiser.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(net.parameters(), MAX_GRAD_NORM)
    optimiser.step()


def _by_episode(flat: Tensor, mask: Tensor) -> Tensor:
    """[episodes, T] from the values [sum T] of all steps in order; 0 after the end of an episode."""
    table = torch.zeros(mask.shape, device=flat.device)
    table[mask] = flat
    return table
