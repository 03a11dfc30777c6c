"""Every algorithm by its name: Algorithm 1, its two halves alone, and what it is compared with on the same nets."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from giirl_core.config import Config
from learner.giirl import Observe, giirl
from learner.protocols import Cloning, Comparable, Net, Played, Read, RewardFn, Rewards, Source


def behavioural_cloning(
    config: Config,
    learner: Cloning[Played, Read, Net, Rewards, RewardFn],
    source: Source[Played],
    steps: Iterable[int],
    observe: Observe,
) -> None:
    """Behavioural cloning on the same net and demonstrations; rollouts are only watched."""
    for step in steps:
        source.take(config.rollout_batch)
        observe(step, learner.cloner.update(learner.demos.sample(config.cloning.batch)))


def train_on_frozen_reward(
    config: Config,
    learner: Comparable[Played, Read, Net, Rewards, RewardFn],
    source: Source[Played],
    steps: Iterable[int],
    observe: Observe,
) -> None:
    """A fresh policy on a reward that was learned before and stays as it is."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        rewards = learner.discriminator.rewards(rollouts, version=step + 1)
        observe(step, learner.policy.update(rollouts, rewards, learner.discriminator.reward_fn))


def train_on_env_reward(
    config: Config,
    learner: Comparable[Played, Read, Net, Rewards, RewardFn],
    source: Source[Played],
    steps: Iterable[int],
    observe: Observe,
) -> None:
    """The same policy optimisation on the page's own sparse reward, which the source then tells."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        observe(step, learner.policy.update(rollouts, learner.carried_rewards(rollouts), None))


def soft_q_imitation(
    config: Config,
    learner: Comparable[Played, Read, Net, Rewards, RewardFn],
    source: Source[Played],
    steps: Iterable[int],
    observe: Observe,
) -> None:
    """SQIL or IQ-Learn: soft Q-learning from demonstrations and rollouts, with no reward in between."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        observe(step, learner.soft_q.update(learner.demos.sample(config.soft_q.batch), rollouts))


class Algorithm(Protocol):
    """A loop over all that a comparable learner can do."""

    def __call__(
        self,
        config: Config,
        learner: Comparable[Played, Read, Net, Rewards, RewardFn],
        source: Source[Played],
        steps: Iterable[int],
        observe: Observe,
    ) -> None: ...


ALGORITHMS: dict[str, Algorithm] = {
    "giirl": giirl,
    "cloning": behavioural_cloning,
    "frozen": train_on_frozen_reward,
    "true_reward": train_on_env_reward,
    "sqil": soft_q_imitation,
    "iq_learn": soft_q_imitation,
}
