"""Goal-Induced Inverse Reinforcement Learning: Algorithm 1 of Luo (2019), line by line.

actors --- tau_pi, g_pi ---> D: expert or policy? --- r(s, a | g) ---> pi: maximise r + alpha H
   ^                          ^                                         |
   |                          +---- tau_E, g_E from D_E                 |
   +----------------------------- pi, and r to score with <-------------+
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Protocol

from giirl.config import Config

Observe = Callable[[int, dict[str, float]], None]


class Source(Protocol):
    """Plays: episodes of web pages, or of a grid. What an episode is only the learner of its world knows."""

    def take(self, episodes: int) -> Any: ...


class Learning(Protocol):
    """The parts that learn in one world, with the verbs that the loop below uses."""

    demos: Any  # sample(count): demonstrations
    discriminator: Any  # update(expert, rollouts, net), rewards(rollouts, version), ask(...): reward of anything
    policy: Any  # net, update(rollouts, rewards, ask)

    def study(self, episodes: Any) -> Any: ...


def giirl(config: Config, learner: Learning, source: Source, steps: Iterable[int], observe: Observe) -> None:
    """Learn a reward and a policy together. `observe` publishes, reports and saves after every step."""
    demos, discriminator, policy = learner.demos, learner.discriminator, learner.policy
    for step in steps:
        rollouts = learner.study(source.take(config.rollout_batch))  # collect tau_pi by executing pi on task xi
        expert = demos.sample(config.discriminator.batch)  # tau_E, g_E from D_E
        d = discriminator.update(expert, rollouts, policy.net)  # binary logistic regression (eq. 3.2)
        rewards = discriminator.rewards(rollouts, version=step + 1)  # r(s, a | g) = log D - log(1 - D)
        p = policy.update(rollouts, rewards, discriminator.ask)  # policy optimisation (eq. 3.1)
        observe(step, {**d, **p})
