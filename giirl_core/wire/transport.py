"""ZeroMQ sockets: many dealers connect to one router; message sizes, sending queues and waits are bounded."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache

import zmq
from zmq.auth.thread import ThreadAuthenticator
from zmq.utils.monitor import recv_monitor_message

from giirl_core.wire.addresses import endpoint, is_loopback, split_key
from giirl_core.wire.messages import MAX_BYTES

SEND_HIGH_WATER_MARK = 256  # queued messages for each connection
LINGER_MS = 500  # how long a closing socket may still send
BACKLOG = 4096  # connections waiting to be accepted: all actors reconnect at once when a learner restarts
MAX_SOCKETS = 1 << 16  # in one process: simulations run thousands of actors in one
KEEPALIVE_S = 5  # silence on a connection before the kernel probes the peer, and between two probes
PEER_TIMEOUT_MS = 15_000  # a peer whose kernel acknowledges nothing for this long is disconnected
SEND_MORE = int(zmq.DONTWAIT | zmq.SNDMORE)
WAKE_ADDRESS = "inproc://wake"
RECONNECT_MS = 100
RECONNECT_MAX_MS = 1_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Keys:
    """A CURVE key pair. Each process of a run has its own, and only tells its public key.

    Raises ValueError when a key is malformed or the two do not belong together.
    """

    public: bytes  # Z85
    secret: bytes = field(repr=False)  # Z85

    def __post_init__(self) -> None:
        try:
            matches = zmq.curve_public(self.secret) == self.public
        except (ValueError, zmq.ZMQError) as error:
            raise ValueError(f"CURVE secret key is malformed: {error}; wanted 40 characters of Z85") from error
        if not matches:
            raise ValueError(f"CURVE secret key does not belong to the public key {self.public!r}")

    @classmethod
    def generate(cls) -> Keys:
        """A new random pair."""
        public, secret = zmq.curve_keypair()
        return cls(public=public, secret=secret)


class Router:
    """The listening socket. Belongs to one thread; only `wake` and `allow` may be called from others.

    Without keys it listens on loopback only. With keys only holders of the same pair can connect, and of those that
    `allow` names. `address` has the form of `addresses`. Raises ValueError when it cannot bind.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0, *, keys: Keys | None = None) -> None:
        if keys is None and not is_loopback(host):
            raise ValueError(f"cannot listen on {host}:{port} without CURVE keys, wanted a loopback address or keys")
        if not 0 <= port < 1 << 16:
            raise ValueError(f"port {port} is out of range, wanted 0 to 65535")
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._allowed = _AllowedKeys()
        self._authenticator = _start_authenticator(self._context, self._allowed) if keys else None
        self._socket = _new_socket(self._context, zmq.ROUTER)
        self._timeouts = _Timeouts(self._socket)
        self._wake_lock, self._woken = threading.Lock(), False
        self._waker = _new_socket(self._context, zmq.DEALER)
        self._waker_id = self._connect_waker()
        self._socket.backlog = BACKLOG
        self._failed_handshakes = _FailedHandshakes(self._socket)
        self._socket.router_mandatory = True  # a send to a disconnected peer is an error, not a silent loss
        self._socket.router_handover = True  # a peer that reconnects keeps its identity
        if keys:
            self._own_key = keys.public
            self.allow([])
            self._socket.curve_server = True
            self._socket.curve_publickey = keys.public
            self._socket.curve_secretkey = keys.secret
        self._socket.ipv6 = ":" in host
        try:
            self._socket.bind(endpoint(host, port))
        except zmq.ZMQError as error:
            self.close()
            raise ValueError(f"cannot listen on {host}:{port}: {error}; wanted a free port, or 0") from error
        self.address = self._socket.getsockopt_string(zmq.LAST_ENDPOINT).removeprefix("tcp://")
        if keys:
            self.address += f" {keys.public.decode()}"

    def allow(self, public_keys: Iterable[bytes]) -> None:
        """From now on, only holders of one of these keys or of the router's own can connect."""
        self._allowed.keys = frozenset([self._own_key, *public_keys])

    @property
    def refusals(self) -> int:
        """Number of connections refused: because of a wrong or missing key, or another protocol."""
        return self._failed_handshakes.count()

    def recv(self, timeout_s: float) -> tuple[bytes, bytes] | None:
        """(sender, message); None after the timeout or after `wake`."""
        self._timeouts.set(zmq.RCVTIMEO, timeout_s)
        try:
            peer, *frames = self._socket.recv_multipart()
        except zmq.Again:
            return None
        if peer == self._waker_id:
            self._woken = False
            return None
        return peer, _single_frame(frames)

    def send(self, peer: bytes, message: bytes) -> bool:
        """Send without waiting; False when the peer is not connected or its queue is full."""
        try:
            self._socket.send(peer, SEND_MORE)
            self._socket.send(message, zmq.DONTWAIT)
        except zmq.ZMQError as error:
            if error.errno not in (zmq.EAGAIN, zmq.EHOSTUNREACH):
                raise
            return False
        return True

    def wake(self) -> None:
        """Make a `recv` in another thread return early."""
        with self._wake_lock:
            if not self._woken:  # one message is enough until `recv` has read it
                self._woken = True
                self._waker.send(b"")

    def close(self) -> None:
        """Send queued messages for at most LINGER_MS, then release the port."""
        self._failed_handshakes.close()
        self._waker.close()
        self._socket.close()
        if self._authenticator:
            self._authenticator.stop()
        self._context.destroy(linger=LINGER_MS)

    def _connect_waker(self) -> bytes:
        """Connect the waker before any other peer; returns its identity, which no other peer can take then."""
        self._socket.bind(WAKE_ADDRESS)
        self._waker.connect(WAKE_ADDRESS)
        self._waker.send(b"")
        return self._socket.recv_multipart()[0]


class Dealer:
    """The connecting socket; reconnects automatically. Belongs to one thread.

    `address` is that of a router. With keys, one without a public key belongs to a router with the same pair.
    `identity` is the name under which the router sees it. Raises ValueError for a bad identity or address.
    """

    def __init__(self, address: str, *, identity: bytes, keys: Keys | None = None) -> None:
        if not 1 <= len(identity) <= 255 or identity.startswith(b"\0"):
            raise ValueError(f"identity is {identity!r:.80}, wanted 1 to 255 bytes, the first not 0")
        where, server_key = split_key(address)
        self._socket = _new_socket(_dealer_context(), zmq.DEALER)
        self._socket.identity = identity
        self._socket.immediate = True  # queue nothing while disconnected: `send` fails and the caller keeps the message
        self._socket.reconnect_ivl = RECONNECT_MS
        self._socket.reconnect_ivl_max = RECONNECT_MAX_MS
        if keys:
            self._socket.curve_publickey = keys.public
            self._socket.curve_secretkey = keys.secret
            self._socket.curve_serverkey = server_key or keys.public
        self._failed_handshakes = _FailedHandshakes(self._socket)
        self._timeouts = _Timeouts(self._socket)
        self.address, self._endpoint = address, f"tcp://{where}"
        self._refusals, self._connected_s = 0, time.monotonic()
        self._socket.ipv6 = address.startswith("[")
        try:
            self._socket.connect(self._endpoint)
        except zmq.ZMQError as error:
            self.close()
            raise ValueError(f"cannot connect to {address!r}: {error}; wanted host:port") from error

    @property
    def refusals(self) -> int:
        """Number of failed connection attempts: the key is wrong, or the other end is not a router."""
        return self._failed_handshakes.count()

    def recv(self, timeout_s: float) -> bytes | None:
        """The next message; None after the timeout."""
        self._timeouts.set(zmq.RCVTIMEO, timeout_s)
        try:
            return _single_frame(self._socket.recv_multipart())
        except zmq.Again:
            return None

    def send(self, message: bytes, timeout_s: float = 0.0) -> bool:
        """Send within the timeout; False when there is no connection or its queue stays full."""
        self._timeouts.set(zmq.SNDTIMEO, timeout_s)
        try:
            self._socket.send(message)
        except zmq.Again:
            refusals = self._failed_handshakes.count()  # also empties a queue: full, it would block all sockets
            if refusals > self._refusals and time.monotonic() > self._connected_s + RECONNECT_MAX_MS / 1000:
                self._refusals, self._connected_s = refusals, time.monotonic()
                self._connect_again()
            return False
        return True

    def _connect_again(self) -> None:
        """Try again after a refusal, which libzmq takes as final: the router may allow this key by now."""
        with suppress(zmq.ZMQError):
            self._socket.disconnect(self._endpoint)
        self._socket.connect(self._endpoint)

    def close(self) -> None:
        """Close the connection; queued messages are still sent in the background for at most LINGER_MS."""
        self._failed_handshakes.close()
        self._socket.close()


class _Timeouts:
    """Caches a socket's timeout options. Letting recv() and send() time out saves one poll() for each message."""

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self._socket, self._current_ms = socket, {zmq.RCVTIMEO: -1, zmq.SNDTIMEO: -1}

    def set(self, option: zmq.SocketOption, timeout_s: float) -> None:
        timeout_ms = max(0, round(timeout_s * 1000))
        if self._current_ms[option] != timeout_ms:
            self._socket.setsockopt(option, timeout_ms)
            self._current_ms[option] = timeout_ms


class _FailedHandshakes:
    """Counts the failed handshakes of one socket; belongs to the socket's thread."""

    EVENTS = (
        zmq.EVENT_HANDSHAKE_FAILED_AUTH | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    )

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self._socket, self._count = socket, 0
        self._monitor = socket.get_monitor_socket(self.EVENTS)

    def count(self) -> int:
        while self._monitor.poll(0):
            recv_monitor_message(self._monitor)
            self._count += 1
        return self._count

    def close(self) -> None:
        self._socket.disable_monitor()
        self._monitor.close(linger=0)


@cache
def _dealer_context() -> zmq.Context[zmq.Socket[bytes]]:
    """The context of all dealers of this process: one, because each context has its own threads."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    context.max_sockets = MAX_SOCKETS
    return context


def _new_socket(context: zmq.Context[zmq.Socket[bytes]], kind: int) -> zmq.Socket[bytes]:
    """A socket with all options set. It has no receive limit and no ZMTP heartbeats, because libzmq aborts on either.

    Up to version 4.3.5, libzmq aborts the process when it writes to a connection after an I/O error
    (stream_engine_base.cpp:310). It keeps such a connection if the peer disconnects while input is stopped, which is so
    when the receiving queue is full, the socket closes, or another connection takes over the identity. Two things then
    write: the timer of heartbeats, and the answer to a PING of the peer when a full queue has space again. The kernel
    finds dead peers instead, and our protocols bound what waits to be received. `tests.chaos.abort` counts aborts.
    """
    socket = context.socket(kind)
    socket.linger = LINGER_MS
    socket.sndhwm, socket.rcvhwm, socket.maxmsgsize = SEND_HIGH_WATER_MARK, 0, MAX_BYTES
    socket.tcp_keepalive, socket.tcp_keepalive_cnt = 1, PEER_TIMEOUT_MS // 1000 // KEEPALIVE_S
    socket.tcp_keepalive_idle = socket.tcp_keepalive_intvl = KEEPALIVE_S
    socket.tcp_maxrt = PEER_TIMEOUT_MS  # TCP_USER_TIMEOUT
    return socket


class _AllowedKeys:
    """Accepts only clients with one of these public keys."""

    keys: frozenset[bytes] = frozenset()

    def callback(self, domain: str, key: bytes) -> bool:
        return key in self.keys


def _start_authenticator(context: zmq.Context[zmq.Socket[bytes]], allowed: _AllowedKeys) -> ThreadAuthenticator:
    authenticator = ThreadAuthenticator(context)
    authenticator.start()
    authenticator.configure_curve_callback(domain="*", credentials_provider=allowed)
    return authenticator


def _single_frame(frames: Sequence[bytes]) -> bytes:
    """The only frame of a message; b"", which is not a valid message, when a foreign peer sent several frames."""
    return frames[0] if len(frames) == 1 else b""
