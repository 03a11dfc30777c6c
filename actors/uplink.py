"""Brings finished episodes to the learner, paced by its credits, and keeps each until a checkpoint covers it."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, replace

from actors.episode_counter import EpisodeCounter, Replaced
from giirl_core.types import Episode
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.delivery import Grant, Notice
from giirl_core.wire.messages import Stamp, WireError
from giirl_core.wire.transport import Dealer, Keys

LOG = logging.getLogger(__name__)
WAIT_S = 0.02
RECONNECT_S = 0.02  # before looking again whether there is a connection


class Refused(RuntimeError):
    """The learner takes nothing from this actor: a newer one replaced it, or it is of another run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UplinkLimits:
    """How much is kept, and how patiently."""

    pause_at: int = 8  # episodes not yet acked by the learner: then the actor should stop playing
    max_kept_bytes: int = 64 << 20  # of copies that no checkpoint covers yet: then, too
    beat_s: float = 1.0
    hello_s: float = 0.5  # between attempts to be known

    def __post_init__(self) -> None:
        if self.pause_at < 1 or self.max_kept_bytes < 1 or min(self.beat_s, self.hello_s) <= 0:
            raise ValueError(f"{self} cannot work: wanted numbers from 1 and times above 0")


@dataclass(slots=True, kw_only=True)
class _Copy:
    message: bytes
    after: int | None = None  # the last notice before it was sent; None: not on its way


class Uplink:
    """One actor's line to the learner. Nothing here waits, except `flush` and `settle`; belongs to one thread."""

    def __init__(
        self,
        address: str,
        *,
        run: str,
        actor: str,
        incarnation: int,
        tally: EpisodeCounter,
        limits: UplinkLimits | None = None,
        keys: Keys | None = None,
    ) -> None:
        self._stamp = Stamp(run=run, actor=actor, incarnation=incarnation, sequence=0)
        self._tally, self._keys = tally, keys
        self._limits = limits or UplinkLimits()
        self._waiting: dict[int, _Copy] = {}  # not acked yet, in order of sequence
        self._acked: dict[int, _Copy] = {}  # acked, but in no checkpoint
        self._kept_bytes = 0
        self._committed = 0
        self._finished = 0
        self._notices = 0
        self._leaving = False
        self._connect(address)

    @property
    def ready(self) -> bool:
        """Whether to go on playing."""
        return self.unacked < self._limits.pause_at and self._kept_bytes < self._limits.max_kept_bytes

    @property
    def unacked(self) -> int:
        """Episodes the learner has not yet taken in or dropped."""
        return len(self._waiting)

    @property
    def kept(self) -> int:
        """Episodes the learner may still ask for again."""
        return len(self._waiting) + len(self._acked)

    @property
    def silent_for_s(self) -> float:
        """How long ago the learner was last heard."""
        return time.monotonic() - self._heard_s

    def offer(self, episode: Episode) -> int:
        """Take charge of an episode; returns its sequence number. From here on it is finished, and accounted for."""
        message = wire.encode_episode(episode, stamp=replace(self._stamp, sequence=self._finished))
        try:
            sequence = self._tally.add()
        except Replaced as error:
            raise Refused(f"actor {self._stamp.actor!r} has nothing to finish any more: {error}") from None
        assert sequence == self._finished
        self._waiting[sequence] = _Copy(message=message)
        self._kept_bytes += len(message)
        self._finished += 1
        self.poll()
        return sequence

    def poll(self) -> None:
        """Hear the learner, then send what it will take. Raises Refused when it will never take anything."""
        self._hear(0.0)
        self._speak()

    def flush(self, timeout_s: float) -> bool:
        """Wait until the learner has acked every episode; False when it has not in time."""
        return self._outlast(self._waiting, timeout_s)

    def settle(self, timeout_s: float) -> bool:
        """Ask for a checkpoint, and wait until it covers everything: then this actor may go for good."""
        self._leaving = True
        return self.flush(timeout_s) and self._outlast(self._acked, timeout_s)

    def redirect(self, address: str) -> None:
        """The learner came back elsewhere: offer it what no checkpoint covers."""
        self._dealer.close()
        self._connect(address)

    def close(self) -> None:
        """Say good-bye and end the connection. What has not been acked is lost, and the learner counts it."""
        if self._known:
            self._tell(delivery.BYE)
        self._dealer.close()

    def _connect(self, address: str) -> None:
        identity = f"{self._stamp.actor}#{self._stamp.incarnation}".encode()
        self._dealer = Dealer(address, identity=identity, keys=self._keys)
        self._heard_s = time.monotonic()
        self._begin()

    def _begin(self) -> None:
        """This learner knows nothing of us, and we nothing of what it has acked."""
        self._known, self._limit = False, 0
        self._hailed = self._notices  # grants that answer earlier notices are of another learner
        self._told_s = self._said_s = self._cut_until_s = float("-inf")
        kept = sorted({**self._acked, **self._waiting}.items())
        self._acked.clear()
        self._waiting.clear()
        for sequence, copy in kept:
            copy.after = None
            self._waiting[sequence] = copy

    def _hear(self, wait_s: float) -> None:
        while (message := self._dealer.recv(wait_s)) is not None:
            wait_s = 0.0
            try:
                header, _ = wire.decode(message)
                kind = header["kind"]
                grant = delivery.read_grant(header) if kind == delivery.GRANT else None
            except WireError as error:
                LOG.warning("ignored a message of the learner: %s", error)
                continue
            self._heard_s = time.monotonic()
            if delivery.is_refused(header, self._stamp):
                known = self._stamp
                raise Refused(
                    f"the learner refuses actor {known.actor!r}, incarnation {known.incarnation}, "
                    f"of run {known.run!r}: {header.get('reason')!r:.80}"
                )
            if kind == delivery.UNKNOWN_ACTOR and self._known:
                self._begin()
            if grant is not None and grant.incarnation == self._stamp.incarnation and grant.notice > self._hailed:
                self._follow(grant)

    def _follow(self, grant: Grant) -> None:
        self._known, self._limit = True, grant.limit
        acked = set(grant.acked)
        for sequence, copy in list(self._waiting.items()):
            if sequence < grant.low_watermark or sequence in acked:
                self._acked[sequence] = self._waiting.pop(sequence)
            elif copy.after is not None and copy.after < grant.notice:
                copy.after = None  # said after it and heard before it: it was lost, or came above the limit
        if grant.committed > self._committed:
            self._committed = grant.committed
            for sequence in [sequence for sequence in self._acked if sequence < grant.committed]:
                self._kept_bytes -= len(self._acked.pop(sequence).message)
        try:
            self._tally.settle(grant.settled)
        except Replaced as error:
            raise Refused(f"actor {self._stamp.actor!r} is not wanted any more: {error}") from None

    def _speak(self) -> None:
        now_s = time.monotonic()
        if now_s < self._cut_until_s:
            return
        in_flight = any(copy.after is not None for copy in self._waiting.values())
        if not self._known:
            if now_s - self._told_s >= self._limits.hello_s:
                self._tell(delivery.HELLO)
        elif now_s - (self._told_s if in_flight else self._said_s) >= self._limits.beat_s:
            self._tell(delivery.HEARTBEAT)
        for sequence, copy in self._waiting.items():
            if sequence >= self._limit:
                break
            if copy.after is None:
                if not self._dealer.send(copy.message):
                    break
                copy.after, self._said_s = self._notices, now_s

    def _tell(self, kind: str) -> None:
        notice = Notice(
            kind=kind,
            stamp=replace(self._stamp, sequence=min([self._finished, *self._waiting, *self._acked])),
            number=self._notices + 1,
            finished=self._finished,
            full=self._leaving or 2 * self._kept_bytes >= self._limits.max_kept_bytes,
            before=self._tally.before,
        )
        now_s = time.monotonic()
        if self._dealer.send(delivery.encode_notice(notice)):
            self._notices += 1
            self._told_s = self._said_s = now_s
        else:
            self._cut_until_s = now_s + RECONNECT_S

    def _outlast(self, copies: dict[int, _Copy], timeout_s: float) -> bool:
        deadline_s = time.monotonic() + timeout_s
        self._speak()
        while copies and time.monotonic() < deadline_s:
            self._hear(WAIT_S)
            self._speak()
        return not copies
