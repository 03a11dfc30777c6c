"""Goal-Induced Inverse Reinforcement Learning: Algorithm 1 of Luo (2019), line by line.

actors --- tau_pi, g_pi ---> D: expert or policy? --- r(s, a | g) ---> pi: maximise r + alpha H
   ^                          ^                                         |
   |                          +---- tau_E, g_E from D_E                 |
   +----------------------------- pi, and r to score with <-------------+
"""

from __future__ import annotations

from collections.abc import Iterable

from giirl_core.config import Config
from learner.protocols import LearnerParts, Observe, Source


def giirl(config: Config, learner: LearnerParts, source: Source, steps: Iterable[int], observe: Observe) -> None:
    """Learn a reward and a policy together. `observe` publishes, reports and saves after every step."""
    demos, discriminator, policy = learner.demos, learner.discriminator, learner.policy
    for step in steps:
        rollouts = learner.featurise(source.take(config.rollout_batch))  # collect tau_pi by executing pi on task xi
        expert = demos.sample(config.discriminator.batch)  # tau_E, g_E from D_E, which people may extend
        d = discriminator.update(expert, rollouts, policy.net)  # binary logistic regression (eq. 3.2)
        rewards = discriminator.rewards(rollouts, version=step + 1)  # r(s, a | g) = log D - log(1 - D)
        p = policy.update(rollouts, rewards)  # policy optimisation (eq. 3.1)
        keep_cloning(config, learner)  # not in the thesis, and off by default: stay close to a cloned start
        observe(step, {**d, **p})


def keep_cloning(config: Config, learner: LearnerParts) -> None:
    """Imitate demonstrations for `policy.cloning_updates` updates, after an update of the policy."""
    for _ in range(config.policy.cloning_updates):
        learner.cloner.update(learner.demos.sample(config.cloning.batch))
