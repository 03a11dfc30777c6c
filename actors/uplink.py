"""Sends an actor's finished episodes to the learner and keeps a copy of each until a checkpoint covers it.

The protocol is described in `giirl_core.wire.delivery`. The learner limits the number of unacknowledged episodes with
credits, and it can lose its memory and resume from a checkpoint. Then the uplink sends every kept episode again.
"""

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
RECEIVE_S = 0.02  # longest wait for a message in `flush` and `wait_committed`
RETRY_S = 0.02  # between attempts to send while there is no connection
MAX_NOTICE_BACKOFF = 8  # longest interval between two notices to a learner that does not answer, in normal intervals


class Refused(RuntimeError):
    """The learner refuses this actor: a newer incarnation has replaced it, or it belongs to another run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UplinkLimits:
    """When an actor may start no episode, and how often it sends notices."""

    max_kept_bytes: int = 64 << 20  # of episodes that no checkpoint covers; from here on no episode starts
    heartbeat_s: float = 1.0  # interval
    hello_s: float = 0.5  # interval between attempts to register

    def __post_init__(self) -> None:
        if self.max_kept_bytes < 1 or min(self.heartbeat_s, self.hello_s) <= 0:
            raise ValueError(f"{self} is out of range: wanted limits >= 1 and intervals > 0")


@dataclass(slots=True, kw_only=True)
class _Kept:
    """An encoded episode."""

    message: bytes
    sent_after: int | None = None  # number of the last notice before it was sent; None: not in flight


class Uplink:
    """The connection of one actor to the learner. Belongs to one thread.

    Only `flush` and `wait_committed` block.
    """

    def __init__(
        self,
        address: str,
        *,
        run: str,
        actor: str,
        incarnation: int,
        counter: EpisodeCounter,
        limits: UplinkLimits | None = None,
        keys: Keys | None = None,
    ) -> None:
        self._stamp = Stamp(run=run, actor=actor, incarnation=incarnation, sequence=0)
        self._counter, self._keys = counter, keys
        self._limits = limits or UplinkLimits()
        self._unacked: dict[int, _Kept] = {}  # by sequence number, ascending
        self._acked: dict[int, _Kept] = {}  # acknowledged, but not in a checkpoint
        self._kept_bytes = 0
        self._committed = 0  # sequence numbers below are covered by a checkpoint
        self._finished = 0
        self._notices = 0
        self._leaving = False
        self.idle_share = 0.0  # fraction of the tabs that wait for the learner, set by the worker
        self._connect(address)

    def startable(self, unfinished: int) -> int:
        """How many episodes the actor may start while `unfinished` ones are being played or scored."""
        if self._kept_bytes >= self._limits.max_kept_bytes:
            return 0
        return max(0, self._send_limit - self._finished - unfinished)

    @property
    def unacked(self) -> int:
        """The number of episodes that the learner has neither accepted nor dropped yet."""
        return len(self._unacked)

    @property
    def kept(self) -> int:
        """The number of episodes that no checkpoint covers yet."""
        return len(self._unacked) + len(self._acked)

    @property
    def silent_for_s(self) -> float:
        """Seconds since the learner's last message."""
        return time.monotonic() - self._last_heard_s

    def submit(self, episode: Episode) -> int:
        """Count an episode as finished and deliver it; returns its sequence number.

        Raises Refused if a newer incarnation has replaced this actor; then the episode is not counted.
        """
        message = wire.encode_episode(episode, stamp=replace(self._stamp, sequence=self._finished))
        try:
            sequence = self._counter.add()
        except Replaced as error:
            raise Refused(f"actor {self._stamp.actor!r} cannot finish any more episodes: {error}") from None
        assert sequence == self._finished
        self._unacked[sequence] = _Kept(message=message)
        self._kept_bytes += len(message)
        self._finished += 1
        self.poll()
        return sequence

    def poll(self) -> None:
        """Process the learner's messages and send what its credits allow. Raises Refused if it refuses this actor."""
        self._receive(0.0)
        self._send()

    def flush(self, timeout_s: float) -> bool:
        """Wait until the learner has acknowledged every episode; False on timeout."""
        return self._wait_until_empty(self._unacked, timeout_s)

    def wait_committed(self, timeout_s: float) -> bool:
        """Ask for a checkpoint and wait until it covers every episode; False on timeout.

        After that the actor can leave for good without losing an episode.
        """
        self._leaving = True
        return self.flush(timeout_s) and self._wait_until_empty(self._acked, timeout_s)

    def redirect(self, address: str) -> None:
        """Connect to a learner that was restarted at another address, and send it all kept episodes."""
        self._dealer.close()
        self._connect(address)

    def close(self) -> None:
        """Say goodbye and disconnect. Unacknowledged episodes are lost, and the learner counts them."""
        if self._registered:
            self._send_notice(delivery.BYE)
        self._dealer.close()

    def _connect(self, address: str) -> None:
        identity = f"{self._stamp.actor}#{self._stamp.incarnation}".encode()
        self._dealer = Dealer(address, identity=identity, keys=self._keys)
        self._last_heard_s = time.monotonic()
        self._start_session()

    def _start_session(self) -> None:
        """Begin again with a learner that does not know this actor; its acknowledgements are unknown, too."""
        self._registered, self._send_limit = False, 0
        # Grants that answer earlier notices belong to another session.
        self._session_start = self._answered_notice = self._notices
        self._notice_sent_s = self._sent_s = self._retry_at_s = float("-inf")
        kept = sorted({**self._acked, **self._unacked}.items())
        self._acked.clear()
        self._unacked.clear()
        for sequence, episode in kept:
            episode.sent_after = None
            self._unacked[sequence] = episode

    def _receive(self, wait_s: float) -> None:
        while (message := self._dealer.recv(wait_s)) is not None:
            wait_s = 0.0
            try:
                header, _ = wire.decode(message)
                kind = header["kind"]
                grant = delivery.read_grant(header) if kind == delivery.GRANT else None
            except WireError as error:
                LOG.warning("ignored a message from the learner: %s", error)
                continue
            self._last_heard_s = time.monotonic()
            if delivery.is_refused(header, self._stamp):
                stamp = self._stamp
                raise Refused(
                    f"the learner refuses actor {stamp.actor!r}, incarnation {stamp.incarnation}, "
                    f"of run {stamp.run!r}: {header.get('reason')!r:.80}"
                )
            if kind == delivery.UNKNOWN_ACTOR and self._registered:
                self._start_session()
            if (
                grant is not None
                and grant.incarnation == self._stamp.incarnation
                and grant.notice > self._session_start
            ):
                self._apply(grant)

    def _apply(self, grant: Grant) -> None:
        self._registered, self._send_limit = True, grant.limit
        self._answered_notice = grant.notice
        acked = set(grant.acked)
        for sequence, episode in list(self._unacked.items()):
            if sequence < grant.low_watermark or sequence in acked:
                self._acked[sequence] = self._unacked.pop(sequence)
            elif episode.sent_after is not None and episode.sent_after < grant.notice:
                # The learner got a notice that was sent after this episode, but did not accept the episode: it was
                # lost on the way, or above the limit.
                episode.sent_after = None
        if grant.committed > self._committed:
            self._committed = grant.committed
            for sequence in [sequence for sequence in self._acked if sequence < grant.committed]:
                self._kept_bytes -= len(self._acked.pop(sequence).message)
        try:
            self._counter.forget_before(grant.settled)
        except Replaced as error:
            raise Refused(f"actor {self._stamp.actor!r} has been replaced: {error}") from None

    def _send(self) -> None:
        """Send the notice that is due, then the episodes below the learner's limit that are not in flight."""
        now_s = time.monotonic()
        if now_s < self._retry_at_s:
            return
        in_flight = any(episode.sent_after is not None for episode in self._unacked.values())
        backoff = self._notice_backoff
        if not self._registered:
            if now_s - self._notice_sent_s >= self._limits.hello_s * backoff:
                self._send_notice(delivery.HELLO)
        elif now_s - (self._notice_sent_s if in_flight else self._sent_s) >= self._limits.heartbeat_s * backoff:
            self._send_notice(delivery.HEARTBEAT)
        for sequence, episode in self._unacked.items():
            if sequence >= self._send_limit:
                break
            if episode.sent_after is None:
                if not self._dealer.send(episode.message):
                    break
                episode.sent_after, self._sent_s = self._notices, now_s

    @property
    def _notice_backoff(self) -> int:
        """Factor of the interval between notices: 1, and twice as much for each further unanswered notice.

        Episodes are limited by credits, but notices are not. At a constant rate those of all actors would pile up in
        the queue of a learner that is slow or stalled.
        """
        unanswered = self._notices - self._answered_notice
        return min(1 << max(0, min(unanswered, MAX_NOTICE_BACKOFF) - 1), MAX_NOTICE_BACKOFF)

    def _send_notice(self, kind: str) -> None:
        notice = Notice(
            kind=kind,
            stamp=replace(self._stamp, sequence=min([self._finished, *self._unacked, *self._acked])),
            number=self._notices + 1,
            finished=self._finished,
            full=self._leaving or 2 * self._kept_bytes >= self._limits.max_kept_bytes,
            before=self._counter.before,
            idle_share=self.idle_share,
        )
        now_s = time.monotonic()
        if self._dealer.send(delivery.encode_notice(notice)):
            self._notices += 1
            self._notice_sent_s = self._sent_s = now_s
        else:
            self._retry_at_s = now_s + RETRY_S
            self._answered_notice = self._notices  # the connection is lost, and with it the answers

    def _wait_until_empty(self, episodes: dict[int, _Kept], timeout_s: float) -> bool:
        deadline_s = time.monotonic() + timeout_s
        self._send()
        while episodes and time.monotonic() < deadline_s:
            self._receive(RECEIVE_S)
            self._send()
        return not episodes
