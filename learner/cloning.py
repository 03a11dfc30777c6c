"""Behavioural cloning on the same policy net: the baseline of figure 4.8 (Luo 2019), and an optional warm-up."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from giirl_core.config import CloningConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.augment import rename
from giirl_core.nets.models import PolicyNet
from learner.actor_critic import gradient_step
from learner.data import Example, collate_steps, steps_of


class Cloner:
    """Maximises E_E[log pi(a | s, g)]."""

    def __init__(self, config: CloningConfig, net: PolicyNet, generator: torch.Generator, *, metrics: Metrics) -> None:
        self.config, self.net, self._generator, self._metrics = config, net, generator, metrics
        self.optimiser = torch.optim.Adam(net.parameters(), lr=config.learning_rate, fused=True)

    def update(self, expert: Sequence[Example]) -> dict[str, float]:
        """One gradient step on all steps of `expert`. Returns the loss and the entropy of the policy, nats."""
        batch, actions = collate_steps(steps_of(expert))
        if self.config.rename_prob:
            batch = rename(batch, actions, self.config.rename_prob, self.config.position_jitter, self._generator)
        batch, actions = batch.to(self.net.device), actions.to(self.net.device)
        with timed_update(self._metrics, "cloning"):
            logp, entropy = self.net.evaluate(self.net.encoder(batch), actions)
            loss = -logp.mean()
            gradient_step(self.optimiser, self.net, loss)
        return {"p_loss": loss.item(), "p_entropy": entropy.mean().item()}
