"""The parts that learn in one world, with the verbs that Algorithm 1 uses: of web pages or of a grid.

`Played` is what a source plays, `Read` the same as nets read it, `Net` pi_theta, `Rewards` r(s_t, a_t | g) of
rollouts, and `Ask` a function that tells r(s, a | g) of anything.
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
Ask = TypeVar("Ask")
Ask_co = TypeVar("Ask_co", covariant=True)
Ask_contra = TypeVar("Ask_contra", contravariant=True)

Stats = dict[str, float]  # what an update tells, by name


class Source(Protocol[Played_co]):
    """Executes pi."""

    def take(self, episodes: int, /) -> Played_co: ...


class Demos(Protocol[Read_co]):
    """D_E."""

    def sample(self, episodes: int, /) -> Read_co: ...


class RewardLearner(Protocol[Read_contra, Net_contra, Rewards_co, Ask_co]):
    """D_phi, read as a reward."""

    @property
    def ask(self) -> Ask_co: ...

    def update(self, expert: Read_contra, rollouts: Read_contra, policy: Net_contra, /) -> Stats: ...

    def rewards(self, rollouts: Read_contra, /, version: int) -> Rewards_co: ...


class PolicyLearner(Protocol[Read_contra, Net_co, Rewards_contra, Ask_contra]):
    """pi_theta and its optimiser."""

    @property
    def net(self) -> Net_co: ...

    def update(self, rollouts: Read_contra, rewards: Rewards_contra, ask: Ask_contra, /) -> Stats: ...


class Learning(Protocol[Played_contra, Read, Net, Rewards, Ask]):
    """All that Algorithm 1 needs."""

    @property
    def demos(self) -> Demos[Read]: ...

    @property
    def discriminator(self) -> RewardLearner[Read, Net, Rewards, Ask]: ...

    @property
    def policy(self) -> PolicyLearner[Read, Net, Rewards, Ask]: ...

    def study(self, episodes: Played_contra, /) -> Read: ...


class CloningLearner(Protocol[Read_contra]):
    """pi_theta again, learning from demonstrations alone."""

    def update(self, expert: Read_contra, /) -> Stats: ...


class QLearner(Protocol[Read_contra]):
    """pi_theta again, learning from demonstrations and rollouts without a reward in between."""

    def update(self, expert: Read_contra, rollouts: Read_contra, /) -> Stats: ...


class Cloning(Learning[Played_contra, Read, Net, Rewards, Ask], Protocol[Played_contra, Read, Net, Rewards, Ask]):
    """A learner that can also do without a reward."""

    @property
    def cloner(self) -> CloningLearner[Read]: ...


class Comparable(Cloning[Played_contra, Read, Net, Rewards, Ask], Protocol[Played_contra, Read, Net, Rewards, Ask]):
    """One that can do all that its own is compared with."""

    @property
    def policy(self) -> PolicyLearner[Read, Net, Rewards, Ask | None]: ...

    @property
    def soft_q(self) -> QLearner[Read]: ...

    def told(self, rollouts: Read, /) -> Rewards: ...
