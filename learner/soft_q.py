"""Imitation without a discriminator, for comparison: SQIL and IQ-Learn on the policy's own net."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from giirl_core.config import SoftQConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.augment import rename
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.models import PolicyNet
from learner.actor_critic import descend
from learner.data import Example, Replay, Step, collate_steps
from learner.losses import iq_loss, sqil_loss

TARGET_RATE = 0.05  # how fast SQIL's target net follows
CHI = 0.5  # of IQ-Learn; a larger one allows larger rewards


class SoftQ:
    """Soft Q-learning from demonstrations and rollouts that nobody scores.

    Q(s, a | g) = V(s | g) + alpha log pi(a | s, g): every soft Q function is of this form, with V its soft value and
    pi the policy that is optimal for it, so the net of an actor-critic is one of soft Q-learning as well. An
    episode that is over is worth nothing more.
    """

    def __init__(
        self,
        config: SoftQConfig,
        form: str,  # "sqil" or "iq_learn"
        net: PolicyNet,
        replay: Replay,
        rng: np.random.Generator,
        generator: torch.Generator,
        *,
        metrics: Metrics,
    ) -> None:
        self.config, self.form, self.net, self.replay = config, form, net, replay
        self._rng, self._generator, self._metrics = rng, generator, metrics
        self.optimiser = torch.optim.Adam(net.parameters(), lr=config.learning_rate, fused=True)
        # Follows `net` slowly: SQIL's Q moves towards what it says of the next page. The table of words is shared.
        self.target = copy.deepcopy(net, {id(net.encoder.table): net.encoder.table}) if form == "sqil" else net

    def update(self, expert: Sequence[Example], rollouts: Sequence[Example]) -> dict[str, float]:
        """Train on fresh draws from `expert` and from all rollouts so far."""
        self.replay.add(rollouts)
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            with timed_update(self._metrics, "policy"):
                stats = self._descend(expert, self.replay.sample(self.config.batch))
        return stats

    def _descend(self, expert: Sequence[Example], played: Sequence[Example]) -> dict[str, float]:
        config = self.config
        shown = [expert[i % len(expert)] for i in range(config.batch)]
        now, ahead = _transitions([*shown, *played], self._rng)
        batch, actions = collate_steps(now)
        later = collate([(there or here).features for here, there in zip(now, ahead, strict=True)])
        if config.rename_prob:  # both pages of a transition in the same other words
            state = self._generator.get_state()
            batch = rename(batch, actions, config.rename_prob, config.position_jitter, self._generator)
            self._generator.set_state(state)
            later = rename(later, actions, config.rename_prob, config.position_jitter, self._generator)
        device = self.net.device
        batch, actions, later = batch.to(device), actions.to(device), later.to(device)
        seen = self.net.encoder(batch)
        logp, entropy = self.net.evaluate(seen, actions)
        value = self.net.state_value(seen)
        goes_on = torch.tensor([there is not None for there in ahead], device=device)
        following = self._values_ahead(later, goes_on)
        q = value + config.temperature * logp.squeeze(1)
        implied, drop = q - config.gamma * following, value - config.gamma * following
        of_expert, of_policy = implied[: len(shown)], implied[len(shown) :]
        loss = sqil_loss(of_expert, of_policy) if self.form == "sqil" else iq_loss(of_expert, of_policy, drop, CHI)
        descend(self.optimiser, self.net, loss)
        if self.target is not self.net:
            self.follow(TARGET_RATE)
        return {
            "p_loss": loss.item(),
            "p_entropy": entropy.mean().item(),
            "p_implied_expert": of_expert.mean().item(),
            "p_implied_rollouts": of_policy.mean().item(),
        }

    @torch.no_grad()
    def follow(self, share: float) -> None:
        """Move the target that far towards the net; all the way with 1."""
        torch._foreach_lerp_(list(self.target.parameters()), list(self.net.parameters()), share)

    def _values_ahead(self, ahead: Batch, goes_on: Tensor) -> Tensor:
        """V(s') [B], 0 where the episode is over. SQIL's stays while Q moves towards it, IQ-Learn's is learned."""
        with torch.set_grad_enabled(self.form == "iq_learn"):
            return torch.where(goes_on, self.target.state_value(self.target.encoder(ahead)), 0.0)


def _transitions(examples: Sequence[Example], rng: np.random.Generator) -> tuple[list[Step], list[Step | None]]:
    """One step of each example, all equally likely, and the step after it, None after the last."""
    now: list[Step] = []
    ahead: list[Step | None] = []
    for example in examples:
        steps = [Step(f, a) for f, a in zip(example.features, example.trajectory.actions, strict=True)]
        t = int(rng.integers(len(steps)))
        now.append(steps[t])
        ahead.append(steps[t + 1] if t + 1 < len(steps) else None)
    return now, ahead
