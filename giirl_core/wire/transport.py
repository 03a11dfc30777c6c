"""Sockets: many dealers talk to one router, with bounds on every queue, message and wait."""

from __future__ import annotations

import ipaddress
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import zmq
from zmq.auth.thread import ThreadAuthenticator
from zmq.utils.monitor import recv_monitor_message

from giirl_core.wire.messages import MAX_BYTES

HIGH_WATER = 256  # messages in each direction and connection
LINGER_MS = 500  # how long a closing socket may still send
BACKLOG = 4096  # connections that may be on their way in: every actor comes back at once when a learner does
MAX_SOCKETS = 1 << 16  # of one process: whoever plays a thousand actors has as many
HEARTBEAT_MS = 2_000
SILENCE_MS = 15_000  # a peer that answers no heartbeat for so long is gone
MORE = int(zmq.DONTWAIT | zmq.SNDMORE)
ALARM = "inproc://alarm"
RETRY_MS = 100
RETRY_MAX_MS = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Keys:
    """A CURVE key pair. One pair is shared by all processes of a run: whoever holds it may talk."""

    public: bytes  # Z85
    secret: bytes = field(repr=False)  # Z85

    def __post_init__(self) -> None:
        try:
            matches = zmq.curve_public(self.secret) == self.public
        except (ValueError, zmq.ZMQError) as error:
            raise ValueError(f"a CURVE key is malformed: {error}; wanted 40 characters of Z85") from error
        if not matches:
            raise ValueError(f"the CURVE secret does not belong to public key {self.public!r}")

    @classmethod
    def make(cls) -> Keys:
        """A fresh pair."""
        public, secret = zmq.curve_keypair()
        return cls(public=public, secret=secret)

    @classmethod
    def keep(cls, path: Path) -> Keys:
        """Those in `path`; where there are none a fresh pair, which only its owner may read."""
        if not path.exists():
            made = cls.make()
            with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
                file.write(made.public + b"\n" + made.secret + b"\n")
        lines = path.read_bytes().split()
        if len(lines) != 2:
            raise ValueError(f"{path} holds {len(lines)} keys, wanted a public one and its secret")
        return cls(public=lines[0], secret=lines[1])


class Router:
    """The end that listens. Belongs to one thread; only `wake` may be called from others."""

    def __init__(self, host: str = "127.0.0.1", port: int = 0, *, keys: Keys | None = None) -> None:
        if keys is None and not _is_loopback(host):
            raise ValueError(f"cannot listen on {host}:{port} without CURVE keys: wanted a loopback address, or keys")
        if not 0 <= port < 1 << 16:
            raise ValueError(f"port {port} is out of range: wanted 0 to 65535")
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._gate = _gate(self._context, keys) if keys else None
        self._socket = _bounded(self._context, zmq.ROUTER)
        self._patience = _Patience(self._socket)
        self._waking, self._woken = threading.Lock(), False
        self._waker = _bounded(self._context, zmq.DEALER)
        self._alarm = self._hang_up_alarm()
        self._socket.backlog = BACKLOG
        self._turned_away = _Refusals(self._socket)
        self._socket.router_mandatory = True  # sending to a peer that left is an error, not a silent loss
        self._socket.router_handover = True  # a peer that comes back takes its place again
        if keys:
            self._socket.curve_server = True
            self._socket.curve_publickey = keys.public
            self._socket.curve_secretkey = keys.secret
        try:
            self._socket.bind(f"tcp://{host}:{port or '*'}")
        except zmq.ZMQError as error:
            self._end()
            raise ValueError(f"cannot listen on {host}:{port}: {error}; wanted a free port, or 0") from error
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT).removeprefix("tcp://")

    @property
    def refusals(self) -> int:
        """How many connections were turned away: a wrong key or none, or something else than our protocol."""
        return self._turned_away.count()

    def recv(self, timeout_s: float) -> tuple[bytes, bytes] | None:
        """The next message and who sent it; None when none came in time, or after `wake`."""
        self._patience.at_most(zmq.RCVTIMEO, timeout_s)
        try:
            peer, *frames = self._socket.recv_multipart()
        except zmq.Again:
            return None
        if peer == self._alarm:
            self._woken = False
            return None
        return peer, _whole(frames)

    def send(self, peer: bytes, message: bytes) -> bool:
        """False when the peer is gone or takes nothing more; never waits."""
        try:
            self._socket.send(peer, MORE)
            self._socket.send(message, zmq.DONTWAIT)
        except zmq.ZMQError as error:
            if error.errno not in (zmq.EAGAIN, zmq.EHOSTUNREACH):
                raise
            return False
        return True

    def wake(self) -> None:
        """End a `recv` of another thread early."""
        with self._waking:
            if not self._woken:  # else it has been woken, and does not know yet
                self._woken = True
                self._waker.send(b"")

    def close(self) -> None:
        """Send what can be sent at once, then let go of the port."""
        self._end()

    def _hang_up_alarm(self) -> bytes:
        """A connection within this process, before any other: the name that no peer from elsewhere can take."""
        self._socket.bind(ALARM)
        self._waker.connect(ALARM)
        self._waker.send(b"")
        return self._socket.recv_multipart()[0]

    def _end(self) -> None:
        self._turned_away.close()
        self._waker.close()
        self._socket.close()
        if self._gate:
            self._gate.stop()
        self._context.destroy(linger=LINGER_MS)


class Dealer:
    """The end that connects, and connects again whenever the other end comes back. Belongs to one thread."""

    def __init__(self, address: str, *, identity: bytes, keys: Keys | None = None) -> None:
        if not 1 <= len(identity) <= 255 or identity.startswith(b"\0"):
            raise ValueError(f"identity {identity!r:.80} is no name: wanted 1 to 255 bytes, the first not 0")
        self._socket = _bounded(_shared(), zmq.DEALER)
        self._socket.identity = identity
        self._socket.immediate = True  # queue nothing for a peer that is not there: the caller keeps it
        self._socket.reconnect_ivl = RETRY_MS
        self._socket.reconnect_ivl_max = RETRY_MAX_MS
        if keys:
            self._socket.curve_publickey = keys.public
            self._socket.curve_secretkey = keys.secret
            self._socket.curve_serverkey = keys.public
        self._turned_away = _Refusals(self._socket)
        self._patience = _Patience(self._socket)
        self.address = address
        try:
            self._socket.connect(f"tcp://{address}")
        except zmq.ZMQError as error:
            self.close()
            raise ValueError(f"cannot connect to {address!r}: {error}; wanted host:port") from error

    @property
    def refusals(self) -> int:
        """How often the other end has turned this one away: a wrong key, or no router at all."""
        return self._turned_away.count()

    def recv(self, timeout_s: float) -> bytes | None:
        """The next message; None when none came in time."""
        self._patience.at_most(zmq.RCVTIMEO, timeout_s)
        try:
            return _whole(self._socket.recv_multipart())
        except zmq.Again:
            return None

    def send(self, message: bytes, timeout_s: float = 0.0) -> bool:
        """False when there is no connection, or it takes nothing more, until the timeout."""
        self._patience.at_most(zmq.SNDTIMEO, timeout_s)
        try:
            self._socket.send(message)
        except zmq.Again:
            self._turned_away.count()  # what nobody reads there would stop the sockets of this process in the end
            return False
        return True

    def close(self) -> None:
        """Send what can be sent at once, then end the connection."""
        self._turned_away.close()
        self._socket.close()  # its linger bounds how long the process stays for what is unsent


class _Patience:
    """How long a socket waits by itself: that is one look at it less than polling it first."""

    def __init__(self, of: zmq.Socket[bytes]) -> None:
        self._of, self._set_ms = of, {zmq.RCVTIMEO: -1, zmq.SNDTIMEO: -1}

    def at_most(self, option: zmq.SocketOption, timeout_s: float) -> None:
        timeout_ms = max(0, round(timeout_s * 1000))
        if self._set_ms[option] != timeout_ms:
            self._of.setsockopt(option, timeout_ms)
            self._set_ms[option] = timeout_ms


class _Refusals:
    """Counts the handshakes that failed on one socket; belongs to the socket's thread."""

    EVENTS = (
        zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    )

    def __init__(self, watched: zmq.Socket[bytes]) -> None:
        self._watched, self._count = watched, 0
        self._monitor = watched.get_monitor_socket(self.EVENTS)

    def count(self) -> int:
        while self._monitor.poll(0):
            recv_monitor_message(self._monitor)
            self._count += 1
        return self._count

    def close(self) -> None:
        self._watched.disable_monitor()
        self._monitor.close(linger=0)


@cache
def _shared() -> zmq.Context[zmq.Socket[bytes]]:
    """One for all dealers of a process: each context has threads of its own."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    context.max_sockets = MAX_SOCKETS
    return context


def _bounded(context: zmq.Context[zmq.Socket[bytes]], kind: int) -> zmq.Socket[bytes]:
    made = context.socket(kind)
    made.linger = LINGER_MS
    made.sndhwm = made.rcvhwm = HIGH_WATER
    made.maxmsgsize = MAX_BYTES
    made.heartbeat_ivl = HEARTBEAT_MS
    made.heartbeat_timeout = SILENCE_MS
    return made


class _Holders:
    """Lets in who proves to hold the shared key pair."""

    def __init__(self, keys: Keys) -> None:
        self._public = keys.public

    def callback(self, domain: str, key: bytes) -> bool:
        return key == self._public


def _gate(context: zmq.Context[zmq.Socket[bytes]], keys: Keys) -> ThreadAuthenticator:
    gate = ThreadAuthenticator(context)
    gate.start()
    gate.configure_curve_callback(domain="*", credentials_provider=_Holders(keys))
    return gate


def _whole(frames: Sequence[bytes]) -> bytes:
    """A message of ours is one frame. What others send in several reads as nothing, which nobody can decode."""
    return frames[0] if len(frames) == 1 else b""


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
