"""Baselines on the policy net as a soft Q-function: SQIL, IQ-Learn, and Q-learning on the page's own reward."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from giirl_core.config import SoftQConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.augment import rename
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.models import PolicyNet
from learner.actor_critic import copy_net, gradient_step
from learner.data import Example, Replay, Step, collate_steps, steps_of
from learner.losses import iq_loss, sqil_loss

TARGET_RATE = 0.05  # of the moving average that is the target net
LEAST_PRIORITY = 0.01  # of a transition without error
CHI = 0.5  # coefficient of IQ-Learn's chi-square regulariser; a larger one allows larger rewards


class SoftQ:
    """Soft Q-learning: from demonstrations and rollouts without rewards, or from the page's own reward.

    SQIL is from Reddy et al. (2020), IQ-Learn from Garg et al. (2021). `q_learning` is goal-conditioned Q-learning with
    prioritised replay, after DOM-Q-NET (Jia et al. 2019); its rewards are those in the rollouts.

    Every soft Q-function has the form Q(s, a | g) = V(s | g) + alpha log pi(a | s, g), where V is its soft value and pi
    the policy that is optimal for it. The net of an actor-critic therefore also represents a soft Q-function. The value
    after the end of an episode is 0.
    """

    def __init__(
        self,
        config: SoftQConfig,
        form: str,  # "sqil", "iq_learn" or "q_learning"; a learner with another algorithm never updates it
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
        # IQ-Learn bootstraps from the net itself, the others from a slow copy. The word vectors are not copied.
        self.target = copy_net(net) if form in ("sqil", "q_learning") else net

    def update(self, expert: Sequence[Example], rollouts: Sequence[Example]) -> dict[str, float]:
        """Add `rollouts` to the replay buffer, then train on steps of `expert` (not in Q-learning) and of the buffer.

        Returns the statistics of the last gradient step.
        """
        self.replay.add(rollouts)
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            with timed_update(self._metrics, "policy"):
                if self.form == "q_learning":
                    stats = self._train_on_rewards()
                else:
                    stats = self._imitate(expert, self.replay.sample(self.config.batch))
        return stats

    def _train_on_rewards(self) -> dict[str, float]:
        """One gradient step on the squared soft Bellman errors of prioritised transitions."""
        chosen, weights = self.replay.sample_by_priority(self.config.batch)
        implied_reward, _, entropy, rewards = self._implied([self.replay.examples[i] for i in chosen])
        error = implied_reward - rewards
        loss = (torch.from_numpy(weights).to(error.device) * error.pow(2)).mean()
        self._step(loss)
        for index, size in zip(chosen, error.detach().abs().tolist(), strict=True):
            self.replay.priorities[index] = size + LEAST_PRIORITY
        return {"p_loss": loss.item(), "p_entropy": entropy.mean().item(), "p_reward": rewards.mean().item()}

    def _imitate(self, expert: Sequence[Example], rollouts: Sequence[Example]) -> dict[str, float]:
        positives = [expert[i % len(expert)] for i in range(self.config.batch)]
        implied_reward, value_drop, entropy, _ = self._implied([*positives, *rollouts])
        on_expert, on_rollouts = implied_reward[: len(positives)], implied_reward[len(positives) :]
        if self.form == "sqil":
            loss = sqil_loss(on_expert, on_rollouts)
        else:
            loss = iq_loss(on_expert, on_rollouts, value_drop, CHI)
        self._step(loss)
        return {
            "p_loss": loss.item(),
            "p_entropy": entropy.mean().item(),
            "p_implied_expert": on_expert.mean().item(),
            "p_implied_rollouts": on_rollouts.mean().item(),
        }

    def _step(self, loss: Tensor) -> None:
        gradient_step(self.optimiser, self.net, loss)
        if self.target is not self.net:
            self.update_target(TARGET_RATE)

    def _implied(self, examples: Sequence[Example]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of a random step of each example [B]: Q(s, a) - gamma V(s'), V(s) - gamma V(s'), entropy, stored reward."""
        config = self.config
        steps, next_steps, rewards = _transitions(examples, self._rng)
        batch, actions = collate_steps(steps)
        next_batch = collate([(after or step).features for step, after in zip(steps, next_steps, strict=True)])
        if config.rename_prob:  # the same generator state twice: both pages of a transition get the same new words
            state = self._generator.get_state()
            batch = rename(batch, actions, config.rename_prob, config.position_jitter, self._generator)
            self._generator.set_state(state)
            next_batch = rename(next_batch, actions, config.rename_prob, config.position_jitter, self._generator)
        device = self.net.device
        batch, actions, next_batch = batch.to(device), actions.to(device), next_batch.to(device)
        encoding = self.net.encoder(batch)
        logp, entropy = self.net.evaluate(encoding, actions)
        value = self.net.state_value(encoding)
        continues = torch.tensor([after is not None for after in next_steps], device=device)
        next_value = self._next_values(next_batch, continues)
        q = value + config.temperature * logp.squeeze(1)
        stored = torch.tensor(rewards, device=device)
        return q - config.gamma * next_value, value - config.gamma * next_value, entropy, stored

    @torch.no_grad()
    def update_target(self, rate: float) -> None:
        """Move the target net towards the net: target += rate * (net - target). Rate 1 copies the net."""
        torch._foreach_lerp_(list(self.target.parameters()), list(self.net.parameters()), rate)

    def _next_values(self, next_batch: Batch, continues: Tensor) -> Tensor:
        """V(s') [B], in Q-learning max Q(s', .), and 0 where the episode is over. Gradients flow only in IQ-Learn.

        With V in Q-learning, the entropy of a long episode would be worth more than the reward that ends it.
        """
        with torch.set_grad_enabled(self.form == "iq_learn"):
            encoding = self.target.encoder(next_batch)
            value = self.target.state_value(encoding)
            if self.form == "q_learning":
                value = value + self.config.temperature * self.target.highest_logp(encoding)
            return torch.where(continues, value, 0.0)


def _transitions(
    examples: Sequence[Example], rng: np.random.Generator
) -> tuple[list[Step], list[Step | None], list[float]]:
    """A uniformly random step of each example, the step after it, None after the last one, and its stored reward."""
    current: list[Step] = []
    following: list[Step | None] = []
    rewards: list[float] = []
    for example in examples:
        steps = steps_of([example])
        t = int(rng.integers(len(steps)))
        current.append(steps[t])
        following.append(steps[t + 1] if t + 1 < len(steps) else None)
        rewards.append(float(example.trajectory.rewards[t]))
    return current, following, rewards
