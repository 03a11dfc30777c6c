"""The parts that Algorithm 1 is made of, with the verbs that it uses.

The web learner (`learner.learner`) and the grid learner (`learner.grid.learner`) both have them. The two differ in what
passes between the parts, so that is `Any` here, under these names:

                web pages                          grid
    Episodes    list of Trajectory                 Steps
    Batch       list of Example (with features)    Steps
    Rewards     list of tensors [T, 1 + M]         tensor [N]
    Net         PolicyNet                          QNet
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

Episodes: TypeAlias = Any  # played episodes
Batch: TypeAlias = Any  # the same as the nets read them
Rewards: TypeAlias = Any  # r(s_t, a_t | g) of every step of a batch; on web pages also of M sampled actions
Net: TypeAlias = Any  # pi_theta

EXPERT = "expert"  # the discriminator's positive source; its negative sources have the names of their settings
ACCURACY = "d_accuracy_"  # and the name of a source: the fraction of its samples on the right side of D = 1/2
Stats = dict[str, float]  # what an update reports: loss, accuracy, entropy and so on, by name
Observe = Callable[[int, Stats], None]  # called after every step; publishes, reports and saves


class Source(Protocol):
    """Executes the policy in the environment."""

    def take(self, episodes: int, /) -> Episodes: ...


class Demos(Protocol):
    """D_E, the expert demonstrations."""

    def sample(self, episodes: int, /) -> Batch: ...


class RewardLearner(Protocol):
    """D_phi and its optimiser. The reward is computed from D_phi."""

    def update(self, expert: Batch, rollouts: Batch, policy: Net, /) -> Stats: ...

    def rewards(self, rollouts: Batch, /, version: int) -> Rewards: ...


class PolicyLearner(Protocol):
    """pi_theta and its optimiser."""

    @property
    def net(self) -> Net: ...

    def update(self, rollouts: Batch, rewards: Rewards, /) -> Stats: ...


class CloningLearner(Protocol):
    """pi_theta trained on demonstrations alone."""

    def update(self, expert: Batch, /) -> Stats: ...


class QLearner(Protocol):
    """pi_theta as a soft Q-function, trained on rollouts and, where it imitates, on demonstrations."""

    def update(self, expert: Batch, rollouts: Batch, /) -> Stats: ...


class ReplayBuffer(Protocol):
    """Episodes to learn from again."""

    def add(self, rollouts: Batch, /) -> None: ...

    def sample(self, episodes: int, /) -> Batch: ...


class LearnerParts(Protocol):
    """The parts of a learner that Algorithm 1 uses. The cloner keeps the policy close to a cloned start."""

    @property
    def demos(self) -> Demos: ...

    @property
    def discriminator(self) -> RewardLearner: ...

    @property
    def policy(self) -> PolicyLearner: ...

    @property
    def cloner(self) -> CloningLearner: ...

    def featurise(self, episodes: Episodes, /) -> Batch: ...


class BaselineParts(LearnerParts, Protocol):
    """The parts that the other baselines use: four more."""

    @property
    def soft_q(self) -> QLearner: ...

    @property
    def replay(self) -> ReplayBuffer: ...

    def successes(self, rollouts: Batch, /) -> Batch: ...

    def carried_rewards(self, rollouts: Batch, /) -> Rewards: ...
