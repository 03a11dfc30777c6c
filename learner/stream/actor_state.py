"""What the learner knows of one actor: which of its episodes have been judged, and how far it may send."""

from __future__ import annotations

from dataclasses import dataclass, field

from giirl_core.wire.delivery import Grant, IncarnationCounts, Notice
from learner.stream.snapshot import ActorOffsets


@dataclass(slots=True, kw_only=True)
class ActorState:
    """One incarnation of one actor."""

    actor: str
    incarnation: int
    low_watermark: int = 0  # every sequence below has been judged
    acked: set[int] = field(default_factory=set)  # and these above it
    committed: int = 0  # every sequence below is covered by a checkpoint
    settled: int = 0  # incarnations below are closed in a checkpoint
    finished: int = 0  # as far as is known
    notice: int = 0  # the last that was heard
    full: bool = False  # it asked for a checkpoint
    queued: int = 0
    peer: bytes | None = None  # None: gone, or known from a checkpoint alone
    heard_s: float = 0.0

    @classmethod
    def resume(cls, mark: ActorOffsets) -> ActorState:
        """As a checkpoint has it."""
        return cls(
            actor=mark.actor,
            incarnation=mark.incarnation,
            low_watermark=mark.low_watermark,
            acked=set(mark.acked),
            committed=mark.low_watermark,
            settled=mark.incarnation,
            finished=mark.finished,
        )

    def mark(self) -> ActorOffsets:
        """As a checkpoint should have it."""
        return ActorOffsets(
            actor=self.actor,
            incarnation=self.incarnation,
            low_watermark=self.low_watermark,
            acked=tuple(sorted(self.acked)),
            finished=self.finished,
        )

    @property
    def done(self) -> int:
        """How many of its episodes are judged."""
        return self.low_watermark + len(self.acked)

    def is_acked(self, sequence: int) -> bool:
        return sequence < self.low_watermark or sequence in self.acked

    def ack(self, sequence: int) -> None:
        self.acked.add(sequence)
        self.finished = max(self.finished, sequence + 1)
        self._rise()

    def note(self, notice: Notice) -> None:
        """Take down what the actor says of itself."""
        self.notice = max(self.notice, notice.number)
        self.finished = max(self.finished, notice.finished)
        self.full = notice.full

    def skip_to(self, sequence: int) -> int:
        """The actor keeps nothing below; returns how many of those never came."""
        below = {judged for judged in self.acked if judged < sequence}
        missing = max(0, sequence - self.low_watermark) - len(below)
        self.acked -= below
        self.low_watermark = max(self.low_watermark, sequence)
        self._rise()
        return missing

    def succeeded_by(self, before: IncarnationCounts) -> int:
        """How many episodes this incarnation, and later ones, took with them, by what their successor knows."""
        finished = max(self.finished, dict(before).get(self.incarnation, 0))
        between = sum(count for incarnation, count in before if incarnation > self.incarnation)
        return max(0, finished - self.done) + between

    @property
    def wants_commit(self) -> bool:
        """Whether a checkpoint would free an actor that waits for one."""
        return self.full and self.peer is not None and self.low_watermark > self.committed

    def limit(self, credits_: int) -> int:
        """It may send the sequences below."""
        return self.done + max(0, credits_ - self.queued)

    def grant(self, credits_: int) -> Grant:
        return Grant(
            incarnation=self.incarnation,
            notice=self.notice,
            low_watermark=self.low_watermark,
            acked=tuple(sorted(self.acked)),
            committed=self.committed,
            settled=self.settled,
            limit=self.limit(credits_),
        )

    def _rise(self) -> None:
        while self.low_watermark in self.acked:
            self.acked.remove(self.low_watermark)
            self.low_watermark += 1
