"""The training loop of every algorithm: Algorithm 1 and its baselines, on the same nets and demonstrations.

`giirl_core.algorithms` holds the facts about each, under the same names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

from giirl_core.config import Config
from learner.giirl import giirl
from learner.protocols import BaselineLearning, Learning, Observe, Source


def behavioural_cloning(
    config: Config, learner: Learning, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """Behavioural cloning. Rollouts are played only to report the success of the policy."""
    for step in steps:
        source.take(config.rollout_batch)
        observe(step, learner.cloner.update(learner.demos.sample(config.cloning.batch)))


def train_on_frozen_reward(
    config: Config, learner: Learning, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """A fresh policy on a reward that was learned before and does not change."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        rewards = learner.discriminator.rewards(rollouts, version=step + 1)
        observe(step, learner.policy.update(rollouts, rewards))


def train_on_env_reward(
    config: Config, learner: BaselineLearning, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """The same policy optimisation on the sparse reward of the page, which `source` puts into the rollouts."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        observe(step, learner.policy.update(rollouts, learner.carried_rewards(rollouts)))


def soft_q_imitation(
    config: Config, learner: BaselineLearning, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """SQIL or IQ-Learn: soft Q-learning from demonstrations and rollouts, without a reward."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        observe(step, learner.soft_q.update(learner.demos.sample(config.soft_q.batch), rollouts))


# The learner is Any: that of the web or that of the grid, whichever world the algorithm plays.
Loop: TypeAlias = Callable[[Config, Any, Source, Iterable[int], Observe], None]

LOOPS: dict[str, Loop] = {
    "giirl": giirl,
    "cloning": behavioural_cloning,
    "frozen": train_on_frozen_reward,
    "true_reward": train_on_env_reward,
    "sqil": soft_q_imitation,
    "iq_learn": soft_q_imitation,
}
