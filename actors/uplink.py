"""Brings finished episodes to the learner, paced by its credits, and keeps them until it has them safe."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

from giirl import delivery, wire
from giirl.delivery import Grant
from giirl.spec import Episode
from giirl.transport import Dealer, Keys
from giirl.wire import Stamp, WireError

LOG = logging.getLogger(__name__)
WAIT_S = 0.02


class Refused(RuntimeError):
    """The learner takes nothing from this actor: a newer one replaced it, or it is of another run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UplinkLimits:
    """How much is kept, and how patiently."""

    pause_at: int = 8  # episodes not yet judged by the learner: then the actor should stop playing
    max_unjudged: int = 256  # what those still in play may add to that; more is an error
    max_kept: int = 512  # judged episodes kept until committed; more, and the oldest are forgotten
    resend_s: float = 3.0  # an episode sent so long ago and not judged was lost on the way
    beat_s: float = 1.0
    hello_s: float = 0.5  # between attempts to be known

    def __post_init__(self) -> None:
        if not 1 <= self.pause_at <= self.max_unjudged or self.max_kept < 0:
            raise ValueError(f"{self} cannot work: wanted 1 <= pause_at <= max_unjudged and max_kept from 0")
        if min(self.resend_s, self.beat_s, self.hello_s) <= 0:
            raise ValueError(f"{self} cannot work: wanted times above 0")


@dataclass(slots=True, kw_only=True)
class _Copy:
    frames: list[bytes]
    sent_s: float | None = None  # None: not on its way
    judged: bool = False


class Uplink:
    """One actor's line to the learner. Nothing here waits, except `flush`; belongs to one thread."""

    def __init__(
        self,
        address: str,
        *,
        run: str,
        actor: str,
        incarnation: int,
        limits: UplinkLimits | None = None,
        keys: Keys | None = None,
    ) -> None:
        self._stamp = Stamp(run=run, actor=actor, incarnation=incarnation, sequence=0)
        self._limits = limits or UplinkLimits()
        self._dealer = Dealer(address, identity=f"{actor}#{incarnation}".encode(), keys=keys)
        self._kept: dict[int, _Copy] = {}  # in order of sequence
        self._next = 0
        self._known = False  # the learner has answered our last hello
        self._limit = 0
        self._heard_s = time.monotonic()
        self._due_s = 0.0  # of the next hello or beat
        self.forgotten = 0  # episodes given up before they were committed

    @property
    def ready(self) -> bool:
        """Whether to go on playing."""
        return self.unjudged < self._limits.pause_at

    @property
    def unjudged(self) -> int:
        """Episodes the learner has not yet taken in or dropped."""
        return sum(not copy.judged for copy in self._kept.values())

    @property
    def kept(self) -> int:
        """Episodes the learner may still ask for again."""
        return len(self._kept)

    @property
    def silent_for_s(self) -> float:
        """How long ago the learner was last heard."""
        return time.monotonic() - self._heard_s

    def offer(self, episode: Episode) -> int:
        """Take charge of an episode; returns its sequence number."""
        if self.unjudged >= self._limits.max_unjudged:
            raise ValueError(f"{self.unjudged} episodes wait for the learner: play only while `ready`")
        sequence, self._next = self._next, self._next + 1
        self._kept[sequence] = _Copy(frames=wire.encode_episode(episode, stamp=self._stamped(sequence)))
        self.poll()
        return sequence

    def poll(self) -> None:
        """Hear the learner, then send what it will take. Raises Refused when it will never take anything."""
        self._hear(0.0)
        self._speak()

    def flush(self, timeout_s: float) -> bool:
        """Wait until the learner has judged every episode; False when it has not in time."""
        deadline_s = time.monotonic() + timeout_s
        self._speak()
        while self.unjudged and time.monotonic() < deadline_s:
            self._hear(WAIT_S)
            self._speak()
        return not self.unjudged

    def close(self) -> None:
        """End the connection. What has not been judged is lost: `flush` first."""
        self._dealer.close()

    def _stamped(self, sequence: int) -> Stamp:
        known = self._stamp
        return Stamp(run=known.run, actor=known.actor, incarnation=known.incarnation, sequence=sequence)

    def _hear(self, wait_s: float) -> None:
        while (frames := self._dealer.recv(wait_s)) is not None:
            wait_s = 0.0
            try:
                header, _ = wire.decode(frames)
                kind = header["kind"]
                grant = delivery.read_grant(header) if kind == delivery.GRANT else None
            except WireError as error:
                LOG.warning("ignored a message of the learner: %s", error)
                continue
            self._heard_s = time.monotonic()
            if kind == delivery.REFUSED:
                known = self._stamp
                raise Refused(
                    f"the learner refuses actor {known.actor!r}, incarnation {known.incarnation}, "
                    f"of run {known.run!r}: {header.get('reason')!r:.80}"
                )
            if kind == delivery.WHO and self._known:
                self._known, self._limit, self._due_s = False, 0, 0.0
                for copy in self._kept.values():
                    copy.sent_s = None  # what went to the learner before this one is lost
            if grant is not None and grant.incarnation == self._stamp.incarnation:
                self._follow(grant)

    def _follow(self, grant: Grant) -> None:
        self._known, self._limit = True, grant.limit
        for sequence in [sequence for sequence in self._kept if sequence < grant.committed]:
            del self._kept[sequence]
        judged = []
        for sequence, copy in self._kept.items():
            copy.judged = grant.has_judged(sequence)  # no more, where the learner went back to a checkpoint
            if copy.judged:
                judged.append(sequence)
        for sequence in judged[: max(0, len(judged) - self._limits.max_kept)]:
            del self._kept[sequence]
            self.forgotten += 1

    def _speak(self) -> None:
        now_s = time.monotonic()
        if now_s >= self._due_s:
            kind = delivery.BEAT if self._known else delivery.HELLO
            first = next(iter(self._kept), self._next)
            if self._dealer.send(delivery.encode_notice(kind, self._stamped(first))):
                self._due_s = now_s + (self._limits.beat_s if self._known else self._limits.hello_s)
        for sequence, copy in self._kept.items():
            if sequence >= self._limit:
                break
            lost = copy.sent_s is not None and now_s - copy.sent_s >= self._limits.resend_s
            if copy.judged or not (copy.sent_s is None or lost):
                continue
            if not self._dealer.send(copy.frames):
                break
            copy.sent_s = now_s
