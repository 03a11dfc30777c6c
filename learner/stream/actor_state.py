"""Delivery state of one actor on the learner's side: which episodes are acknowledged, and how far it may send."""

from __future__ import annotations

from dataclasses import dataclass, field

from giirl_core.wire.delivery import Grant, IncarnationCounts, Notice
from learner.stream.snapshot import ActorOffsets


@dataclass(slots=True, kw_only=True)
class ActorState:
    """One incarnation of one actor. Sequence numbers count the episodes of this incarnation, from 0."""

    actor: str
    incarnation: int
    low_watermark: int = 0  # every sequence number below is acknowledged
    acked: set[int] = field(default_factory=set)  # acknowledged sequence numbers above the watermark
    committed: int = 0  # every sequence number below is covered by a checkpoint
    settled: int = 0  # the losses of all incarnations below are covered by a checkpoint
    finished: int = 0  # episodes the actor is known to have finished
    notice: int = 0  # number of the last notice received
    full: bool = False  # the actor's buffer is nearly full, so it asked for a checkpoint
    queued: int = 0  # episodes waiting in the learner's queue
    idle_share: float = 0.0  # fraction of its tabs that waited for the learner, from its last notice
    peer: bytes | None = None  # ZeroMQ identity; None after a BYE, or when only known from a checkpoint
    last_heard_s: float = 0.0  # monotonic time

    @classmethod
    def from_offsets(cls, offsets: ActorOffsets) -> ActorState:
        """Restore the state from a checkpoint."""
        return cls(
            actor=offsets.actor,
            incarnation=offsets.incarnation,
            low_watermark=offsets.low_watermark,
            acked=set(offsets.acked),
            committed=offsets.low_watermark,
            settled=offsets.incarnation,
            finished=offsets.finished,
        )

    def offsets(self) -> ActorOffsets:
        """The part of the state that a checkpoint stores."""
        return ActorOffsets(
            actor=self.actor,
            incarnation=self.incarnation,
            low_watermark=self.low_watermark,
            acked=tuple(sorted(self.acked)),
            finished=self.finished,
        )

    @property
    def acked_count(self) -> int:
        """The number of acknowledged episodes."""
        return self.low_watermark + len(self.acked)

    def is_acked(self, sequence: int) -> bool:
        return sequence < self.low_watermark or sequence in self.acked

    def ack(self, sequence: int) -> None:
        self.acked.add(sequence)
        self.finished = max(self.finished, sequence + 1)
        self._advance_watermark()

    def update(self, notice: Notice) -> None:
        """Apply a notice from the actor."""
        self.notice = max(self.notice, notice.number)
        self.finished = max(self.finished, notice.finished)
        self.full, self.idle_share = notice.full, notice.idle_share

    def skip_to(self, sequence: int) -> int:
        """Acknowledge every sequence number below `sequence`; returns how many of those episodes never arrived."""
        acked_below = {acked for acked in self.acked if acked < sequence}
        missing = max(0, sequence - self.low_watermark) - len(acked_below)
        self.acked -= acked_below
        self.low_watermark = max(self.low_watermark, sequence)
        self._advance_watermark()
        return missing

    def lost_with(self, before: IncarnationCounts) -> int:
        """The number of episodes that were lost with this incarnation and with later ones that also ended.

        `before` holds (incarnation, episodes finished) pairs, as the actor's successor reports them.
        """
        finished = max(self.finished, dict(before).get(self.incarnation, 0))
        in_between = sum(count for incarnation, count in before if incarnation > self.incarnation)
        return max(0, finished - self.acked_count) + in_between

    @property
    def wants_commit(self) -> bool:
        """Whether the actor waits for a checkpoint, and a checkpoint now would free some of its buffer."""
        return self.full and self.peer is not None and self.low_watermark > self.committed

    def send_limit(self, window: int) -> int:
        """The actor may start the episodes with sequence numbers below this one, and send them.

        `window` bounds its outstanding episodes: those that it plays, scores or sends, and its queued ones.
        """
        return self.acked_count + max(0, window - self.queued)

    def grant(self, window: int) -> Grant:
        return Grant(
            incarnation=self.incarnation,
            notice=self.notice,
            low_watermark=self.low_watermark,
            acked=tuple(sorted(self.acked)),
            committed=self.committed,
            settled=self.settled,
            limit=self.send_limit(window),
        )

    def _advance_watermark(self) -> None:
        while self.low_watermark in self.acked:
            self.acked.remove(self.low_watermark)
            self.low_watermark += 1
