"""Decides, without any socket, what becomes of each episode: judged once, queued if fresh, counted if not."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from giirl import delivery, wire
from giirl.columns import Columns
from giirl.delivery import Grant
from giirl.metrics import Metrics
from giirl.spec import DEMONSTRATION, UNSCORED, Episode
from giirl.wire import Header, Stamp, WireError
from learner.held import Held, Mark

LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestLimits:
    """How far actors may run ahead, and how far behind their policy may be."""

    credits: int = 4  # episodes of one actor on their way or in the queue
    max_lag: int = 8  # versions; older episodes are dropped, on arrival and again in the queue

    def __post_init__(self) -> None:
        if self.credits < 1 or self.max_lag < 0:
            raise ValueError(f"{self} lets nothing in: wanted credits from 1 and max_lag from 0")


@dataclass(slots=True, kw_only=True)
class _Actor:
    incarnation: int
    floor: int
    judged: set[int] = field(default_factory=set)
    committed: int
    queued: int = 0
    peer: bytes | None = None  # None: known from a checkpoint alone, or not heard since a newer learner began
    heard_s: float = 0.0

    def skip_to(self, sequence: int) -> int:
        """The actor keeps nothing below `sequence`; returns how many of those never came."""
        below = {judged for judged in self.judged if judged < sequence}
        missing = max(0, sequence - self.floor) - len(below)
        self.judged -= below
        self.floor = max(self.floor, sequence)
        self._settle()
        return missing

    def judge(self, sequence: int) -> None:
        self.judged.add(sequence)
        self._settle()

    def _settle(self) -> None:
        while self.floor in self.judged:
            self.judged.remove(self.floor)
            self.floor += 1

    def grant(self, credits_: int) -> Grant:
        return Grant(
            incarnation=self.incarnation,
            floor=self.floor,
            judged=tuple(sorted(self.judged)),
            committed=self.committed,
            limit=self.floor + len(self.judged) + max(0, credits_ - self.queued),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Queued:
    episode: Episode
    owner: _Actor | None  # None: from a checkpoint


class Admission:
    """The books of the ingest. Whoever shares one between threads holds a lock around every call."""

    def __init__(
        self,
        run: str,
        policy_version: Callable[[], int],
        *,
        reward_version: Callable[[], int] | None,
        limits: IngestLimits,
        metrics: Metrics,
        held: Held,
    ) -> None:
        self._run = run
        self._policy_version = policy_version
        self._reward_version = reward_version
        self._limits = limits
        self._metrics = metrics
        self._queue = deque(_Queued(episode=episode, owner=None) for episode in held.episodes)
        self._taken: list[Episode] = []  # of a take that has not come to its end
        self._untold: set[str] = set()  # actors whose grant has changed
        self._actors = {
            mark.actor: _Actor(
                incarnation=mark.incarnation,
                floor=mark.floor,
                judged=set(mark.judged),
                committed=mark.floor,
            )
            for mark in held.marks
        }

    @property
    def queued(self) -> int:
        return len(self._queue) + len(self._taken)

    def hear(self, peer: bytes, frames: list[bytes]) -> list[bytes] | None:
        """Take in one message; returns what has to be answered at once."""
        try:
            header, arrays = wire.decode(frames)
            stamp = wire.read_stamp(header)
        except WireError as error:
            LOG.warning("dropped a message of %r: %s", peer, error)
            self._count_received("damaged")
            return None
        kind = header["kind"]
        if stamp.run != self._run:
            return self._refuse(kind, delivery.OTHER_RUN)
        actor = self._actors.get(stamp.actor)
        if actor and stamp.incarnation < actor.incarnation:
            return self._refuse(kind, delivery.FENCED)
        if kind == delivery.HELLO:
            actor = self._greet(stamp)
            actor.peer = peer
        elif actor is None or stamp.incarnation > actor.incarnation or actor.peer != peer:
            return delivery.encode_who()
        elif kind == delivery.EPISODE:
            self._judge(actor, stamp, header, arrays)
        actor.heard_s = time.monotonic()
        self._untold.add(stamp.actor)
        return None

    def pull(self, episodes: int) -> list[Episode] | None:
        """The next so many fresh episodes; None, and they stay here, while there are too few."""
        version = self._policy_version()
        fresh = [episode for episode in self._taken if not self._is_stale(episode, version)]
        self._drop("stale_queued", len(self._taken) - len(fresh))
        self._taken = fresh
        while self._queue and len(self._taken) < episodes:
            entry = self._queue.popleft()
            if entry.owner:
                entry.owner.queued -= 1
            if self._is_stale(entry.episode, version):
                self._drop("stale_queued")
            else:
                self._taken.append(entry.episode)
            self._untold.update(self._actors)
        if len(self._taken) < episodes:
            return None
        batch, self._taken = self._taken[:episodes], self._taken[episodes:]
        for episode in batch:
            self._observe(episode, version)
        return batch

    def grants(self) -> list[tuple[bytes, list[bytes]]]:
        """What has to be told to whom, once."""
        told = [self._actors[name] for name in sorted(self._untold)]
        self._untold.clear()
        return [
            (actor.peer, delivery.encode_grant(actor.grant(self._limits.credits)))
            for actor in told
            if actor.peer is not None
        ]

    def snapshot(self) -> Held:
        """Everything accepted and not yet pulled, and what has been judged."""
        marks = tuple(
            Mark(actor=name, incarnation=a.incarnation, floor=a.floor, judged=tuple(sorted(a.judged)))
            for name, a in self._actors.items()
        )
        return Held(episodes=(*self._taken, *(entry.episode for entry in self._queue)), marks=marks)

    def commit(self, held: Held) -> None:
        """A checkpoint covers `held`: its actors may forget what it marks."""
        for mark in held.marks:
            actor = self._actors.get(mark.actor)
            if actor and actor.incarnation == mark.incarnation:
                actor.committed = max(actor.committed, mark.floor)
                self._untold.add(mark.actor)

    def silent_for_s(self, name: str) -> float:
        """How long ago an actor was heard; infinite when it never was."""
        actor = self._actors.get(name)
        return time.monotonic() - actor.heard_s if actor and actor.peer is not None else float("inf")

    def excuse(self) -> str:
        """Who is to be asked why there are too few episodes."""
        heard = [f"{name} {self.silent_for_s(name):.1f} s ago" for name in sorted(self._actors)[:8]]
        return f"{self.queued} wait; of {len(self._actors)} actors heard: {', '.join(heard) or 'none'}"

    def _greet(self, stamp: Stamp) -> _Actor:
        actor = self._actors.get(stamp.actor)
        if actor is None or actor.incarnation < stamp.incarnation:
            actor = _Actor(incarnation=stamp.incarnation, floor=stamp.sequence, committed=stamp.sequence)
            self._actors[stamp.actor] = actor
        self._drop("lost", actor.skip_to(stamp.sequence))
        return actor

    def _judge(self, actor: _Actor, stamp: Stamp, header: Header, arrays: Columns) -> None:
        if stamp.sequence < actor.floor or stamp.sequence in actor.judged:
            return self._count_received("duplicate")
        if stamp.sequence >= actor.grant(self._limits.credits).limit:
            return self._count_received("over_credit")  # not judged: it will come again
        actor.judge(stamp.sequence)
        try:
            episode = wire.build_episode(header, arrays)
            if episode.trajectory.policy_version <= DEMONSTRATION:
                raise WireError(f"a rollout has policy version {episode.trajectory.policy_version}")
            with wire.untrusted():
                episode.trajectory.check_learned()
        except WireError as error:
            LOG.warning("dropped episode %d of %s: %s", stamp.sequence, stamp.actor, error)
            return self._count_received("invalid")
        if self._is_stale(episode, self._policy_version()):
            return self._count_received("stale")
        self._count_received("")
        self._queue.append(_Queued(episode=episode, owner=actor))
        actor.queued += 1

    def _is_stale(self, episode: Episode, version: int) -> bool:
        # A policy from ahead of a learner that went back to a checkpoint is as far away as one from behind.
        return abs(version - episode.trajectory.policy_version) > self._limits.max_lag

    def _observe(self, episode: Episode, version: int) -> None:
        self._metrics.policy_lag.observe(max(0, version - episode.trajectory.policy_version))
        if self._reward_version and episode.trajectory.reward_version != UNSCORED:
            lag = self._reward_version() - episode.trajectory.reward_version
            self._metrics.reward_lag.observe(max(0, lag))

    def _refuse(self, kind: str, reason: str) -> list[bytes]:
        if kind == delivery.EPISODE:
            self._count_received(reason)
        return delivery.encode_refused(reason)

    def _count_received(self, dropped: str) -> None:
        self._metrics.trajectories_received.inc()
        if dropped:
            self._drop(dropped)

    def _drop(self, reason: str, episodes: int = 1) -> None:
        if episodes:
            self._metrics.trajectories_dropped.labels(reason).inc(episodes)
