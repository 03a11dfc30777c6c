"""The training loop of every algorithm: Algorithm 1 and its baselines, on the same nets and demonstrations.

`giirl_core.algorithms` describes each algorithm under the same name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

from giirl_core.config import Config
from learner.giirl import giirl, keep_cloning
from learner.protocols import BaselineParts, LearnerParts, Observe, Source


def behavioural_cloning(
    config: Config, learner: LearnerParts, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """Behavioural cloning (figure 4.8 of Luo 2019). Rollouts are played only to report the policy's success."""
    for step in steps:
        source.take(config.rollout_batch)
        for _ in range(config.cloning.updates):
            stats = learner.cloner.update(learner.demos.sample(config.cloning.batch))
        observe(step, stats)


def train_on_frozen_reward(
    config: Config, learner: LearnerParts, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """Train a new policy on the learned reward of another run, which stays fixed."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        rewards = learner.discriminator.rewards(rollouts, version=step + 1)
        stats = learner.policy.update(rollouts, rewards)
        keep_cloning(config, learner)
        observe(step, stats)


def train_on_env_reward(
    config: Config, learner: BaselineParts, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """Train a policy on the page's own sparse reward, which `source` stores in the rollouts."""
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        stats = learner.policy.update(rollouts, learner.carried_rewards(rollouts))
        keep_cloning(config, learner)
        observe(step, stats)


def soft_q_imitation(
    config: Config, learner: BaselineParts, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """SQIL (Reddy et al. 2020) or IQ-Learn (Garg et al. 2021): soft Q-learning from demonstrations and rollouts.

    They learn no reward.
    """
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        observe(step, learner.soft_q.update(learner.demos.sample(config.soft_q.batch), rollouts))


def q_learning(config: Config, learner: BaselineParts, source: Source, steps: Iterable[int], observe: Observe) -> None:
    """Goal-conditioned Q-learning with prioritised replay on the page's own reward (DOM-Q-NET; Jia et al. 2019)."""
    for step in steps:
        observe(step, learner.soft_q.update([], learner.featurise(source.take(config.rollout_batch))))


def workflow_guided_exploration(
    config: Config, learner: BaselineParts, source: Source, steps: Iterable[int], observe: Observe
) -> None:
    """Workflow-guided exploration (WGE; Liu et al. 2018) on the page's own reward.

    Half of the rollouts follow workflows of the demonstrations. The policy also imitates its replayed successes.
    """
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))
        stats = learner.policy.update(rollouts, learner.carried_rewards(rollouts))
        keep_cloning(config, learner)
        learner.replay.add(learner.successes(rollouts))
        for _ in range(config.cloning.updates):
            if successes := learner.replay.sample(config.cloning.batch):
                learner.cloner.update(successes)
        observe(step, stats)


# The learner is Any, because it is the web learner or the grid learner, depending on the world.
Loop: TypeAlias = Callable[[Config, Any, Source, Iterable[int], Observe], None]

LOOPS: dict[str, Loop] = {
    "giirl": giirl,
    "cloning": behavioural_cloning,
    "frozen": train_on_frozen_reward,
    "true_reward": train_on_env_reward,
    "sqil": soft_q_imitation,
    "iq_learn": soft_q_imitation,
    "q_learning": q_learning,
    "wge": workflow_guided_exploration,
}
