"""Decides, without any socket, what becomes of each episode: judged once, queued if fresh, counted if not.

Every episode that an actor finished is, in the history that a checkpoint and its successors make, one of: TAKEN by
the learner, queued, or dropped for one of the reasons in DROPPED. Messages dropped for other reasons are repetitions,
or come again.
"""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass

from giirl_core.goals import is_held_out
from giirl_core.metrics import Metrics
from giirl_core.types import DEMONSTRATION, UNSCORED, Episode
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns
from giirl_core.wire.messages import Header, Stamp, WireError
from learner.stream.actor_state import ActorState
from learner.stream.snapshot import IngestSnapshot

LOG = logging.getLogger(__name__)
TAKEN = "taken"
DROPPED = ("stale", "stale_queued", "invalid", "repeated", "held_out", "lost")


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestLimits:
    """How far actors may run ahead, and how far behind their policy may be."""

    credits: int = 4  # episodes of one actor on their way or in the queue
    max_lag: int = 4  # versions; older episodes are dropped, on arrival and again in the queue; 0 is lock-step
    max_bytes: int = 256 << 20  # in the queue, as they came; then nobody has credits

    def __post_init__(self) -> None:
        if self.credits < 1 or self.max_lag < 0 or self.max_bytes < 1:
            raise ValueError(f"{self} lets nothing in: wanted credits and max_bytes from 1 and max_lag from 0")


@dataclass(slots=True, kw_only=True)
class _Queued:
    """An episode as it came. It becomes one of ours when it is taken or saved, by the thread that does so."""

    header: Header
    arrays: Columns
    episode: Episode | None = None
    version: int  # of its policy
    owner: ActorState
    size: int


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
        held: IngestSnapshot,
        held_out: float = 0.0,
    ) -> None:
        self._run = run
        self._policy_version = policy_version
        self._reward_version = reward_version
        self._limits = limits
        self._metrics = metrics
        self._queue: deque[_Queued] = deque()
        self._bytes = 0
        self._taken: list[Episode] = list(held.episodes)  # of a take that has not come to its end
        self._held_out = held_out
        self._untold: set[str] = set()  # actors whose grant has changed
        self._actors = {mark.actor: ActorState.resume(mark) for mark in held.marks}
        self._counts = Counter(held.counts)

    @property
    def queued(self) -> int:
        return len(self._queue) + len(self._taken)

    @property
    def wants_commit(self) -> bool:
        """Whether an actor can go on only after a checkpoint."""
        return any(actor.wants_commit for actor in self._actors.values())

    def receive(self, peer: bytes, message: bytes) -> bytes | None:
        """Take in one message; returns what has to be answered at once."""
        try:
            header, arrays = wire.decode(message)
            stamp = wire.read_stamp(header)
            notice = delivery.read_notice(header, stamp) if header["kind"] in delivery.NOTICES else None
        except WireError as error:
            LOG.warning("dropped a message of %r: %s", peer, error)
            self._refused("damaged")
            return None
        if stamp.run != self._run:
            return self._refuse(header["kind"], delivery.OTHER_RUN, stamp)
        actor = self._actors.get(stamp.actor)
        if actor and stamp.incarnation < actor.incarnation:
            return self._refuse(header["kind"], delivery.FENCED, stamp)
        if notice and notice.kind == delivery.HELLO:
            actor = self._register(notice)
            actor.peer = peer
        elif actor is None or stamp.incarnation > actor.incarnation or actor.peer != peer:
            return delivery.encode_unknown_actor()
        elif notice is None:
            self._accept(actor, stamp, header, arrays, len(message))
        if notice:
            actor.note(notice)
        if notice and notice.kind == delivery.BYE:
            self._drop("lost", actor.skip_to(actor.finished))
            actor.peer = None
        actor.heard_s = time.monotonic()
        self._untold.add(stamp.actor)
        return None

    def pull(self, episodes: int) -> list[Episode] | None:
        """The next so many fresh episodes; None, and they stay here, while there are too few.

        In lock-step they come in an order of their own, whoever was first, and none of them twice.
        """
        version = self._policy_version()
        fresh = [e for e in self._taken if not self._is_stale(e.trajectory.policy_version, version)]
        self._drop("stale_queued", len(self._taken) - len(fresh))
        self._taken = fresh
        pages = {_page(episode) for episode in fresh}
        full = self._bytes >= self._limits.max_bytes
        while self._queue and len(self._taken) < episodes:
            episode = self._leave_queue(version)
            if episode is None:
                continue
            if not self._limits.max_lag and _page(episode) in pages:
                self._drop("repeated")
            else:
                pages.add(_page(episode))
                self._taken.append(episode)
        if full and self._bytes < self._limits.max_bytes:
            self._untold.update(self._actors)
        if len(self._taken) < episodes:
            return None
        batch, self._taken = self._taken[:episodes], self._taken[episodes:]
        for episode in batch:
            self._observe(episode, version)
        self._counts[TAKEN] += len(batch)
        return batch if self._limits.max_lag else sorted(batch, key=_page)

    def grants(self) -> list[tuple[bytes, bytes]]:
        """What has to be told to whom, once."""
        told = [self._actors[name] for name in sorted(self._untold)]
        self._untold.clear()
        return [
            (actor.peer, delivery.encode_grant(actor.grant(self._credits))) for actor in told if actor.peer is not None
        ]

    def snapshot(self) -> IngestSnapshot:
        """Everything accepted and not yet pulled, what has been judged, and what became of it."""
        version, kept = self._policy_version(), deque[_Queued]()
        for entry in self._queue:
            if self._build(entry, version):
                kept.append(entry)
            else:
                self._release(entry)
        self._queue = kept
        return IngestSnapshot(
            episodes=(*self._taken, *(entry.episode for entry in kept if entry.episode is not None)),
            marks=tuple(actor.mark() for actor in self._actors.values()),
            counts=dict(self._counts),
        )

    def commit(self, held: IngestSnapshot) -> None:
        """A checkpoint covers `held`: its actors may forget what it marks."""
        for mark in held.marks:
            actor = self._actors.get(mark.actor)
            if actor is None:
                continue
            if actor.incarnation == mark.incarnation:
                actor.committed = max(actor.committed, mark.low_watermark)
            actor.settled = max(actor.settled, mark.incarnation)
            self._untold.add(mark.actor)

    def retire(self, name: str, finished: delivery.IncarnationCounts) -> None:
        """An actor has gone for good; its incarnations finished so much, by its own count. What never came is lost."""
        actor = self._actors.get(name) or ActorState(actor=name, incarnation=-1)
        self._drop("lost", actor.succeeded_by(finished))
        incarnation, count = max([(actor.incarnation, max(actor.finished, actor.low_watermark)), *finished])
        if incarnation >= 0:
            self._actors[name] = gone = ActorState(actor=name, incarnation=incarnation, settled=actor.settled)
            gone.low_watermark = gone.finished = count

    def extend_deadlines(self, seconds: float) -> None:
        """Nobody could be heard for so long."""
        for actor in self._actors.values():
            actor.heard_s += seconds

    def silent_for_s(self, name: str) -> float:
        """How long ago an actor was heard; infinite when it never was, or has said good-bye."""
        actor = self._actors.get(name)
        return time.monotonic() - actor.heard_s if actor and actor.peer is not None else float("inf")

    def describe_shortage(self) -> str:
        """Who is to be asked why there are too few episodes."""
        heard = [f"{name} {self.silent_for_s(name):.1f} s ago" for name in sorted(self._actors)[:8]]
        return f"{self.queued} wait; of {len(self._actors)} actors heard: {', '.join(heard) or 'none'}"

    @property
    def _credits(self) -> int:
        return self._limits.credits if self._bytes < self._limits.max_bytes else 0

    def _register(self, notice: delivery.Notice) -> ActorState:
        stamp = notice.stamp
        actor = self._actors.get(stamp.actor)
        if actor is None or actor.incarnation < stamp.incarnation:
            before = actor or ActorState(actor=stamp.actor, incarnation=-1)
            self._drop("lost", before.succeeded_by(notice.before))
            actor = ActorState(actor=stamp.actor, incarnation=stamp.incarnation, settled=before.settled)
            self._actors[stamp.actor] = actor
        self._drop("lost", actor.skip_to(stamp.sequence))
        return actor

    def _accept(self, actor: ActorState, stamp: Stamp, header: Header, arrays: Columns, size: int) -> None:
        if actor.is_acked(stamp.sequence):
            return self._refused("duplicate")
        if stamp.sequence >= actor.limit(self._credits):
            return self._refused("over_credit")  # not judged: it will come again
        self._metrics.trajectories_received.inc()
        actor.ack(stamp.sequence)
        if type(version := header.get("policy_version")) is not int or version <= DEMONSTRATION:
            return self._drop_invalid(stamp.actor, WireError(f"a rollout has policy version {version!r:.80}"))
        if self._is_stale(version, self._policy_version()):
            return self._drop("stale")
        self._queue.append(_Queued(header=header, arrays=arrays, version=version, owner=actor, size=size))
        self._bytes += size
        actor.queued += 1

    def _leave_queue(self, version: int) -> Episode | None:
        """The next one; None when it is not worth having."""
        entry = self._queue.popleft()
        self._release(entry)
        return self._build(entry, version)

    def _release(self, entry: _Queued) -> None:
        """It waits no longer: its actor may send another."""
        self._bytes -= entry.size
        entry.owner.queued -= 1
        self._untold.add(entry.owner.actor)

    def _build(self, entry: _Queued, version: int) -> Episode | None:
        if self._is_stale(entry.version, version):
            self._drop("stale_queued")
            return None
        if entry.episode is None:
            try:
                entry.episode = wire.build_episode(entry.header, entry.arrays)
            except WireError as error:
                self._drop_invalid(entry.owner.actor, error)
                return None
            if is_held_out(entry.episode.trajectory.goal, self._held_out):
                self._drop("held_out")
                return None
        return entry.episode

    def _drop_invalid(self, actor: str, error: WireError) -> None:
        LOG.warning("dropped an episode of %s: %s", actor, error)
        self._drop("invalid")

    def _is_stale(self, played: int, version: int) -> bool:
        # A policy from ahead of a learner that went back to a checkpoint is as far away as one from behind.
        return abs(version - played) > self._limits.max_lag

    def _observe(self, episode: Episode, version: int) -> None:
        self._metrics.policy_lag.observe(max(0, version - episode.trajectory.policy_version))
        if self._reward_version and episode.trajectory.reward_version != UNSCORED:
            self._metrics.reward_lag.observe(max(0, self._reward_version() - episode.trajectory.reward_version))

    def _refuse(self, kind: str, reason: str, stamp: Stamp) -> bytes:
        if kind == delivery.EPISODE:
            self._refused(reason)
        return delivery.encode_refused(reason, stamp)

    def _refused(self, reason: str) -> None:
        """A message that is no new episode, or not yet."""
        self._metrics.trajectories_received.inc()
        self._metrics.trajectories_dropped.labels(reason).inc()

    def _drop(self, reason: str, episodes: int = 1) -> None:
        """An episode that will not be trained on."""
        assert reason in DROPPED
        if episodes:
            self._counts[reason] += episodes
            self._metrics.trajectories_dropped.labels(reason).inc(episodes)


def _page(episode: Episode) -> tuple[str, int]:
    return episode.trajectory.task, episode.trajectory.seed
