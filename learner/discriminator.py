"""D_phi(s, a | g): trained to tell expert from policy, read as a reward."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from giirl_core.config import DiscriminatorConfig
from giirl_core.metrics import Metrics, timed_update
from giirl_core.nets.features import ActionBatch, Batch, rename
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.reward import RewardModel, episode_rewards, reward_of
from giirl_core.types import UNSCORED
from learner.data import Example, ExpertSampler, Replay, Step, collate_steps, last_step, pick_step, steps_of
from learner.losses import gradient_penalty, logistic_loss, trimmed
from learner.protocols import ACCURACY, EXPERT

OWN = ("rollouts", "replay")  # steps that the policy took, at some time
LATELY = 0.05  # how much the newest batch counts in the accuracy of late


class Discriminator:
    """Binary logistic regression of expert (s, a, g) from the policy's, by the sources that the config weighs."""

    def __init__(
        self,
        config: DiscriminatorConfig,
        model: RewardModel,
        demos: ExpertSampler,
        replay: Replay,
        rng: np.random.Generator,
        generator: torch.Generator,
        *,
        reward_lag: int,
        metrics: Metrics,
    ) -> None:
        self.config, self.model, self.demos, self.replay = config, model, demos, replay
        self._reward_lag, self._metrics = reward_lag, metrics
        self.accuracy = 1.0  # of late: the mean share of expert steps, and of the newest rollouts', on their own side
        self.optimiser = torch.optim.Adam(model.net.parameters(), lr=config.learning_rate)
        self._rng, self._generator = rng, generator

    def update(self, expert: Sequence[Example], rollouts: Sequence[Example], policy: PolicyNet) -> dict[str, float]:
        """Train on fresh draws from `expert`, `rollouts` and the other sources; returns loss and accuracies.

        `d_accuracy_SOURCE` is the share of that source's pairs on the right side of D = 1/2.
        """
        stats: dict[str, float] = {}
        for _ in range(self.config.updates):
            with timed_update(self._metrics, "reward"):
                stats = self._descend(self._sources(expert, rollouts, policy), policy)
        for name, value in stats.items():
            if name.startswith(ACCURACY):
                self._metrics.discriminator_accuracy.labels(name.removeprefix(ACCURACY)).set(value)
        if (on_rollouts := stats.get(f"{ACCURACY}rollouts")) is not None:
            self.accuracy += LATELY * ((stats[ACCURACY + EXPERT] + on_rollouts) / 2 - self.accuracy)
        self.replay.add(rollouts)
        return stats

    def rewards(self, rollouts: Sequence[Example], version: int) -> list[Tensor]:
        """r(s_t, a_t | g) [T] of every rollout, at most `reward_lag` versions behind `version`, the one in the making.

        Rewards that came with a rollout are the reward service's, from this very function and older weights.
        Those too old are computed again.
        """
        versions = [example.trajectory.reward_version for example in rollouts]
        carried = [scored != UNSCORED and 0 <= version - scored <= self._reward_lag for scored in versions]
        stale = [example for example, fresh in zip(rollouts, carried, strict=True) if not fresh]
        again = iter(self._score(stale))
        self._metrics.trajectories_trained.labels("service").inc(sum(carried))
        self._metrics.trajectories_trained.labels("learner").inc(len(stale))
        return [
            torch.tensor(example.trajectory.rewards) if fresh else next(again)
            for example, fresh in zip(rollouts, carried, strict=True)
        ]

    def _score(self, rollouts: Sequence[Example]) -> list[Tensor]:
        """r(s_t, a_t | g) [T] of every rollout by the net as it is now."""
        if not rollouts:
            return []
        lengths = [len(example.features) for example in rollouts]
        logits = self._judge(*collate_steps(steps_of(rollouts))).squeeze(1)
        return episode_rewards(logits, lengths, self.config.reward, self.config.clip)

    def reward_fn(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """r(s, a | g) [B, M] of M actions on each page, taken or not."""
        return reward_of(self._judge(batch, actions), self.config.reward, self.config.clip)

    @torch.no_grad()
    def _judge(self, batch: Batch, actions: ActionBatch) -> Tensor:
        self.model.net.eval()
        logits: Tensor = self.model.net(batch, actions)
        return logits

    def _sources(
        self, expert: Sequence[Example], rollouts: Sequence[Example], policy: PolicyNet
    ) -> dict[str, tuple[float, list[Step]]]:
        """Steps by where they come from, with the weight each counts with; the expert's come first."""
        config, rng = self.config, self._rng
        pick = pick_step if config.train_on == "all_steps" else last_step
        shown = [pick(expert[i % len(expert)], rng) for i in range(config.batch)]
        sources = {EXPERT: (1.0, shown)}
        new = [pick(rollouts[i], rng) for i in rng.integers(len(rollouts), size=config.batch)]
        if config.rollouts:
            sources["rollouts"] = (config.rollouts, new)
        if config.replay:
            sources["replay"] = (config.replay, [pick(old, rng) for old in self.replay.sample(config.batch)])
        if config.policy_on_expert_states:
            sources["policy_on_expert_states"] = (
                config.policy_on_expert_states,
                self._act(shown, policy, by_chance=False),
            )
        if config.random_actions:
            both = shown[::2] + new[1::2]
            sources["random_actions"] = (config.random_actions, self._act(both, policy, by_chance=True))
        if config.wrong_goal:
            sources["wrong_goal"] = (config.wrong_goal, self.demos.wrong_goals(expert))
        return {name: (weight, steps) for name, (weight, steps) in sources.items() if steps}

    @torch.no_grad()
    def _act(self, shown: Sequence[Step], policy: PolicyNet, by_chance: bool) -> list[Step]:
        """What the policy, or chance, would do on these pages.

        The policy's actions on the experts' pages are a difference that no memory of pages can explain. Chance
        keeps what is wrong wrong for as long as training lasts, on the policy's pages too, where a good policy
        does nothing wrong any more and the right action would be the only one ever called a policy's.
        """
        batch, _ = collate_steps(shown)
        uniform = torch.rand(len(shown), 1, 3, generator=self._generator)
        actions, _ = policy.sample(batch, uniform, torch.tensor([by_chance]))
        return [Step(step.features, action) for step, action in zip(shown, actions.first(), strict=True)]

    def _descend(self, sources: dict[str, tuple[float, list[Step]]], policy: PolicyNet) -> dict[str, float]:
        config, net = self.config, self.model.net
        net.train()
        batch, actions = collate_steps([step for _, steps in sources.values() for step in steps])
        page = batch
        if config.rename_prob:
            batch = rename(batch, actions, config.rename_prob, config.position_jitter, self._generator)
        read = net.encode(batch, actions)
        logits = net.head(read).flatten()
        if config.form == "airl":
            with torch.no_grad():
                logp, _, _ = policy.evaluate(page, actions)  # by the page's own words, which are all that it knows
            logits = logits - logp.flatten()
        parts = dict(zip(sources, logits.split([len(steps) for _, steps in sources.values()]), strict=True))
        counted = {
            name: trimmed(part, config.discard_top_fraction) if name in OWN else part for name, part in parts.items()
        }
        loss = logistic_loss(parts[EXPERT], [(w, counted[name]) for name, (w, _) in sources.items() if name != EXPERT])
        penalty = config.gradient_penalty * gradient_penalty(logits, [read]) if config.gradient_penalty else 0 * loss
        self.optimiser.zero_grad()
        (loss + penalty).backward()
        self.optimiser.step()
        stats = {"d_loss": loss.item(), "d_penalty": penalty.item()}
        for name, part in parts.items():
            right = part > 0 if name == EXPERT else part < 0
            stats[ACCURACY + name] = right.float().mean().item()
        return stats
