"""Admission control without sockets: each episode that an actor sends is queued once, or dropped and counted.

In the history of a checkpoint and the checkpoints before it, every episode that an actor finished is TAKEN by the
learner, queued, LOST, or dropped for one of the reasons in DROPPED. Messages rejected for any other reason are
duplicates, or the actor sends them again.
"""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from giirl_core.gestures import BASIC, Gesture
from giirl_core.metrics import Metrics
from giirl_core.telemetry.series import DROPPED
from giirl_core.types import DEMONSTRATION, UNSCORED, Episode
from giirl_core.wire import delivery
from giirl_core.wire.delivery import EpisodeMessage, Notice
from giirl_core.wire.messages import Stamp, WireError
from learner.stream.actor_state import ActorState
from learner.stream.episode_queue import EpisodeQueue, Queued
from learner.stream.flow import FlowControl, IngestLimits
from learner.stream.snapshot import ActorOffsets, IngestSnapshot

LOG = logging.getLogger(__name__)
TAKEN = "taken"
LOST = "lost"


@dataclass(frozen=True, slots=True, kw_only=True)
class Frozen:
    """The state at one moment, before the queued episodes are built: that takes long, and needs no lock."""

    version: int
    pulled: tuple[Episode, ...]
    entries: tuple[Queued, ...]
    offsets: tuple[ActorOffsets, ...]
    counts: Counter[str]


class Admission:
    """The delivery state of all actors. Not thread-safe: threads that share one must hold a lock around every call."""

    def __init__(
        self,
        run: str,
        policy_version: Callable[[], int],
        *,
        reward_version: Callable[[], int] | None,
        limits: IngestLimits,
        metrics: Metrics,
        snapshot: IngestSnapshot,
        held_out: float = 0.0,
        gestures: Sequence[Gesture] = BASIC,
    ) -> None:
        self._run, self._limits, self._metrics = run, limits, metrics
        self._policy_version, self._reward_version = policy_version, reward_version
        self._queue = EpisodeQueue(limits.max_lag, held_out, gestures)
        self._pulled: list[Episode] = list(snapshot.episodes)  # out of the queue, but the batch is still too small
        self._grants_due: set[str] = set()  # actors whose grant has changed
        self._actors = {offsets.actor: ActorState.from_offsets(offsets) for offsets in snapshot.offsets}
        self._counts = Counter(snapshot.counts)
        self._flow = FlowControl(limits.batch, limits.max_lag, stale=self.stale)

    @property
    def queued(self) -> int:
        return len(self._queue) + len(self._pulled)

    @property
    def wants_commit(self) -> bool:
        """Whether an actor has to wait for a checkpoint before it can go on."""
        return any(actor.wants_commit for actor in self._actors.values())

    @property
    def stale(self) -> int:
        return self._counts["stale"] + self._counts["stale_queued"]

    @property
    def idle_share(self) -> float:
        shares = [actor.idle_share for actor in self._actors.values() if actor.peer is not None]
        return sum(shares) / max(len(shares), 1)

    def receive(self, peer: bytes, message: bytes) -> bytes | None:
        """Process one message from an actor; returns the reply to send at once, if any."""
        try:
            received = delivery.parse(message)
        except WireError as error:
            LOG.warning("dropped a message from %r: %s", peer, error)
            self._count_rejected("damaged")
            return None
        stamp = received.stamp
        if reason := self._why_refused(stamp):
            if isinstance(received, EpisodeMessage):
                self._count_rejected(reason)
            return delivery.encode_refused(reason, stamp)
        if isinstance(received, Notice) and received.kind == delivery.HELLO:
            self._register(received, peer)
        actor = self._actors.get(stamp.actor)
        if actor is None or stamp.incarnation > actor.incarnation or actor.peer != peer:
            return delivery.encode_unknown_actor()
        if isinstance(received, EpisodeMessage):
            self._accept(actor, received)
        else:
            actor.update(received)
            if received.kind == delivery.BYE:
                self._lose(actor.skip_to(actor.finished))
                actor.peer = None
        self._hear(actor)
        self._grants_due.add(stamp.actor)
        return None

    def pull(self, episodes: int) -> list[Episode] | None:
        """Remove and return the next `episodes` fresh episodes; None, and nothing is lost, while there are too few.

        In lock-step each page is used once, and the batch is sorted by page, so that it does not depend on timing.
        """
        version = self._policy_version()
        fresh = [e for e in self._pulled if not self._queue.is_stale(e.trajectory.policy_version, version)]
        self._drop("stale_queued", len(self._pulled) - len(fresh))
        self._pulled = fresh
        pages = {_page(episode) for episode in fresh}
        was_full = self._queue.bytes >= self._limits.max_bytes
        while self._queue and len(self._pulled) < episodes:
            entry = self._queue.popleft()
            self._grants_due.add(entry.owner.actor)
            problem = self._queue.check(entry, version)
            if not problem and entry.episode is not None:
                if self._limits.max_lag or _page(entry.episode) not in pages:
                    pages.add(_page(entry.episode))
                    self._pulled.append(entry.episode)
                    continue
                problem = "repeated"
            self._drop(problem)
        if was_full and self._queue.bytes < self._limits.max_bytes:
            self._grants_due.update(self._actors)
        if len(self._pulled) < episodes:
            return None
        batch, self._pulled = self._pulled[:episodes], self._pulled[episodes:]
        for episode in batch:
            self._observe_lag(episode, version)
        self._flow.observe([version - episode.trajectory.policy_version for episode in batch], self.stale)
        self._counts[TAKEN] += len(batch)
        self._metrics.trajectories_taken.inc(len(batch))
        return batch if self._limits.max_lag else sorted(batch, key=_page)

    def grants(self) -> list[tuple[bytes, bytes]]:
        """(peer, encoded grant) for every actor whose grant has changed since the last call."""
        due = [self._actors[name] for name in sorted(self._grants_due)]
        self._grants_due.clear()
        connected = [actor.actor for actor in self._actors.values() if actor.peer is not None]
        windows = self._flow.windows(connected, self._credits)
        return [(a.peer, delivery.encode_grant(a.grant(windows[a.actor]))) for a in due if a.peer is not None]

    def freeze(self) -> Frozen:
        """The state that a checkpoint has to store. Call `build` and then `snapshot` with it."""
        return Frozen(
            version=self._policy_version(),
            pulled=tuple(self._pulled),
            entries=self._queue.entries,
            offsets=tuple(actor.offsets() for actor in self._actors.values()),
            counts=self._counts.copy(),
        )

    def build(self, frozen: Frozen) -> dict[Queued, str]:
        """Build the queued episodes; returns why some cannot be trained on. The only call that needs no lock."""
        return {entry: why for entry in frozen.entries if (why := self._queue.check(entry, frozen.version))}

    def snapshot(self, frozen: Frozen, problems: Mapping[Queued, str]) -> IngestSnapshot:
        """The frozen state for a checkpoint. Drops the episodes with problems; none may be pulled in between."""
        self._queue.remove(problems)
        for entry, problem in problems.items():
            self._grants_due.add(entry.owner.actor)
            self._drop(problem)
        queued = [entry.episode for entry in frozen.entries if entry not in problems and entry.episode is not None]
        return IngestSnapshot(
            episodes=(*frozen.pulled, *queued),
            offsets=frozen.offsets,
            counts=dict(frozen.counts + Counter(problems.values())),
        )

    def commit(self, snapshot: IngestSnapshot) -> None:
        """A checkpoint with `snapshot` is on disk: actors may discard the episodes that it covers."""
        for offsets in snapshot.offsets:
            if (actor := self._actors.get(offsets.actor)) is None:
                continue
            if actor.incarnation == offsets.incarnation:
                actor.committed = max(actor.committed, offsets.low_watermark)
            actor.settled = max(actor.settled, offsets.incarnation)
            self._grants_due.add(offsets.actor)

    def retire(self, name: str, finished: delivery.IncarnationCounts) -> None:
        """Remove an actor for good. Of `finished`, its own count per incarnation, what never arrived is lost."""
        actor = self._actors.get(name) or ActorState(actor=name, incarnation=-1)
        self._lose(actor.lost_with(finished))
        incarnation, count = max([(actor.incarnation, max(actor.finished, actor.low_watermark)), *finished])
        if incarnation >= 0:
            self._actors[name] = retired = ActorState(actor=name, incarnation=incarnation, settled=actor.settled)
            retired.low_watermark = retired.finished = count
        self._forget_time(name)

    def extend_deadlines(self, seconds: float) -> None:
        """Do not count the last `seconds` as silence: this process was not listening."""
        for actor in self._actors.values():
            actor.last_heard_s += seconds

    def silent_for_s(self, name: str) -> float:
        """Seconds since the actor's last message; infinite if there was none, or if the last one was BYE."""
        actor = self._actors.get(name)
        return time.monotonic() - actor.last_heard_s if actor and actor.peer is not None else float("inf")

    def describe_shortage(self) -> str:
        """How many episodes are queued and when actors were last heard, for an error message."""
        heard = [f"{name} {self.silent_for_s(name):.1f} s ago" for name in sorted(self._actors)[:8]]
        return f"{self.queued} queued; last messages from {len(self._actors)} actors: {', '.join(heard) or 'none'}"

    @property
    def _credits(self) -> int:
        return self._limits.credits if self._queue.bytes < self._limits.max_bytes else 0

    def _why_refused(self, stamp: Stamp) -> str:
        """Why the learner will never accept this actor incarnation; "" if it may."""
        if stamp.run != self._run:
            return delivery.OTHER_RUN
        actor = self._actors.get(stamp.actor)
        return delivery.FENCED if actor and stamp.incarnation < actor.incarnation else ""

    def _register(self, hello: Notice, peer: bytes) -> None:
        stamp = hello.stamp
        actor = self._actors.get(stamp.actor)
        if actor is None or actor.incarnation < stamp.incarnation:
            previous = actor or ActorState(actor=stamp.actor, incarnation=-1)
            self._lose(previous.lost_with(hello.before))
            actor = ActorState(actor=stamp.actor, incarnation=stamp.incarnation, settled=previous.settled)
            self._actors[stamp.actor] = actor
        self._lose(actor.skip_to(stamp.sequence))
        actor.peer = peer

    def _hear(self, actor: ActorState) -> None:
        actor.last_heard_s = time.monotonic()
        if actor.peer is not None:
            self._metrics.actor_last_heard.labels(actor.actor).set_to_current_time()
        else:
            self._forget_time(actor.actor)

    def _forget_time(self, name: str) -> None:
        """Serve no time of an actor that has left: it would look like silence."""
        self._metrics.actor_last_heard.remove(name)

    def _accept(self, actor: ActorState, message: EpisodeMessage) -> None:
        sequence = message.stamp.sequence
        if actor.is_acked(sequence):
            self._count_rejected("duplicate")
        elif sequence >= actor.send_limit(self._credits):
            self._count_rejected("over_credit")  # not acknowledged, so the actor sends it again
        else:
            self._metrics.trajectories_received.inc()
            actor.ack(sequence)
            self._enqueue(actor, message)

    def _enqueue(self, actor: ActorState, message: EpisodeMessage) -> None:
        version = message.header.get("policy_version")
        if type(version) is not int or version <= DEMONSTRATION:
            LOG.warning("dropped an episode from %s: policy_version is %.80r, wanted an int >= 0", actor.actor, version)
            self._drop("invalid")
        elif self._queue.is_stale(version, self._policy_version()):
            self._drop("stale")
        else:
            self._queue.append(message, version, actor)

    def _observe_lag(self, episode: Episode, version: int) -> None:
        self._metrics.policy_lag.observe(max(0, version - episode.trajectory.policy_version))
        if self._reward_version and episode.trajectory.reward_version != UNSCORED:
            self._metrics.reward_lag.observe(max(0, self._reward_version() - episode.trajectory.reward_version))

    def _count_rejected(self, reason: str) -> None:
        """Count a message that brought no new episode, or one that is sent again."""
        self._metrics.trajectories_received.inc()
        self._metrics.trajectories_rejected.labels(reason).inc()

    def _drop(self, reason: str, episodes: int = 1) -> None:
        """Count episodes that arrived but will not be trained on."""
        assert reason in DROPPED
        if episodes:
            self._counts[reason] += episodes
            self._metrics.trajectories_dropped.labels(reason).inc(episodes)

    def _lose(self, episodes: int) -> None:
        """Count episodes that an actor finished and that will not arrive."""
        if episodes:
            self._counts[LOST] += episodes
            self._metrics.trajectories_lost.inc(episodes)


def _page(episode: Episode) -> tuple[str, int]:
    return episode.trajectory.task, episode.trajectory.seed
