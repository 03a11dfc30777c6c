"""The parts that learn in one world, with the verbs that Algorithm 1 uses: of web pages or of a grid.

`Played` is what a source plays, `Read` the same as nets read it, `Net` pi_theta, `Rewards` r(s_t, a_t | g) of
rollouts, and `RewardFn` a function that tells r(s, a | g) of anything.
"""

from __future__ import annotations

from typing import Protocol, TypeVar

Played = TypeVar("Played")
Played_co = TypeVar("Played_co", covariant=True)
Played_contra = TypeVar("Played_contra", contravariant=True)
Read = TypeVar("Read")
Read_co = TypeVar("Read_co", covariant=True)
Read_contra = TypeVar("Read_contra", contravariant=True)
Net = TypeVar("Net")
Net_co = TypeVar("Net_co", covariant=True)
Net_contra = TypeVar("Net_contra", contravariant=True)
Rewards = TypeVar("Rewards")
Rewards_co = TypeVar("Rewards_co", covariant=True)
Rewards_contra = TypeVar("Rewards_contra", contravariant=True)
RewardFn = TypeVar("RewardFn")
RewardFn_co = TypeVar("RewardFn_co", covariant=True)
RewardFn_contra = TypeVar("RewardFn_contra", contravariant=True)

Stats = dict[str, float]  # what an update tells, by name


class Source(Protocol[Played_co]):
    """Executes pi."""

    def take(self, episodes: int, /) -> Played_co: ...


class Demos(Protocol[Read_co]):
    """D_E."""

    def sample(self, episodes: int, /) -> Read_co: ...


class RewardLearner(Protocol[Read_contra, Net_contra, Rewards_co, RewardFn_co]):
    """D_phi, read as a reward."""

    @property
    def reward_fn(self) -> RewardFn_co: ...

    def update(self, expert: Read_contra, rollouts: Read_contra, policy: Net_contra, /) -> Stats: ...

    def rewards(self, rollouts: Read_contra, /, version: int) -> Rewards_co: ...


class PolicyLearner(Protocol[Read_contra, Net_co, Rewards_contra, RewardFn_contra]):
    """pi_theta and its optimiser."""

    @property
    def net(self) -> Net_co: ...

    def update(self, rollouts: Read_contra, rewards: Rewards_contra, reward_fn: RewardFn_contra, /) -> Stats: ...


class Learning(Protocol[Played_contra, Read, Net, Rewards, RewardFn]):
    """All that Algorithm 1 needs."""

    @property
    def demos(self) -> Demos[Read]: ...

    @property
    def discriminator(self) -> RewardLearner[Read, Net, Rewards, RewardFn]: ...

    @property
    def policy(self) -> PolicyLearner[Read, Net, Rewards, RewardFn]: ...

    def featurise(self, episodes: Played_contra, /) -> Read: ...


class CloningLearner(Protocol[Read_contra]):
    """pi_theta again, learning from demonstrations alone."""

    def update(self, expert: Read_contra, /) -> Stats: ...


class QLearner(Protocol[Read_contra]):
    """pi_theta again, learning from demonstrations and rollouts without a reward in between."""

    def update(self, expert: Read_contra, rollouts: Read_contra, /) -> Stats: ...


class Cloning(
    Learning[Played_contra, Read, Net, Rewards, RewardFn], Protocol[Played_contra, Read, Net, Rewards, RewardFn]
):
    """A learner that can also do without a reward."""

    @property
    def cloner(self) -> CloningLearner[Read]: ...


class Comparable(
    Cloning[Played_contra, Read, Net, Rewards, RewardFn], Protocol[Played_contra, Read, Net, Rewards, RewardFn]
):
    """One that can do all that its own is compared with."""

    @property
    def policy(self) -> PolicyLearner[Read, Net, Rewards, RewardFn | None]: ...

    @property
    def soft_q(self) -> QLearner[Read]: ...

    def carried_rewards(self, rollouts: Read, /) -> Rewards: ...
