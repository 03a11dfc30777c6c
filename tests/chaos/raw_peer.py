"""Peers of our sockets that speak ZMTP 3.1 (https://rfc.zeromq.org/spec/37) byte by byte, and can misbehave."""

from __future__ import annotations

import random
import select
import socket
import struct
import threading
from collections.abc import Callable
from contextlib import suppress

HOST = "127.0.0.1"
TIMEOUT_S = 5.0
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01" + b"NULL".ljust(20, b"\0") + bytes(32)
MESSAGE = b"\x00\x05hello"
PING = b"\x04\x07\x04PING\x00\x00"  # a command; the peer answers it at once
OVERSIZED = b"\x02" + struct.pack(">Q", 1 << 40)  # the start of a frame of 1 TiB


def connect(address: str, *, identity: bytes = b"") -> socket.socket:
    """Connect to a router, and complete the handshake."""
    host, _, port = address.rpartition(":")
    return _handshake(socket.create_connection((host, int(port)), TIMEOUT_S), b"DEALER", identity)


def serve(script: Callable[[socket.socket], object], *, handshake: bool = True) -> str:
    """Run `script` in a thread on the first connection of a dealer, after its handshake; returns the address."""
    server = socket.create_server((HOST, 0))

    def run() -> None:
        with server, suppress(OSError):
            peer = server.accept()[0]
            script(_handshake(peer, b"ROUTER", b"") if handshake else peer)

    threading.Thread(target=run, daemon=True).start()
    return f"{HOST}:{server.getsockname()[1]}"


def reset(peer: socket.socket) -> None:
    """Disconnect with a TCP reset, as the kernel does for a process that is killed with unread input."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    peer.close()


def damaging_relay(address: str, rng: random.Random, *, intact: int) -> str:
    """Relay the bytes of one connection to `address`; after `intact` bytes corrupt some, then reset both ends."""
    server = socket.create_server((HOST, 0))
    host, _, port = address.rpartition(":")

    def run() -> None:
        with server, suppress(OSError):
            near = server.accept()[0]
            far = socket.create_connection((host, int(port)), TIMEOUT_S)
            other, left = {near: far, far: near}, intact
            while left > -intact:
                for end in select.select([near, far], [], [], TIMEOUT_S)[0]:
                    data = bytearray(end.recv(1 << 14))
                    left -= max(1, len(data))
                    if left < 0 and data and rng.random() < 0.5:
                        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
                    other[end].sendall(data)
            reset(near)
            reset(far)

    threading.Thread(target=run, daemon=True).start()
    return f"{HOST}:{server.getsockname()[1]}"


def _handshake(peer: socket.socket, kind: bytes, identity: bytes) -> socket.socket:
    peer.settimeout(TIMEOUT_S)
    peer.sendall(GREETING)
    received = b""
    while len(received) < len(GREETING):
        received += peer.recv(4096)
    peer.sendall(ready(kind, identity))
    return peer


def ready(kind: bytes, identity: bytes) -> bytes:
    """The command that ends a handshake."""
    body = b"\x05READY" + _property(b"Socket-Type", kind) + _property(b"Identity", identity)
    return bytes([4, len(body)]) + body


def _property(name: bytes, value: bytes) -> bytes:
    return bytes([len(name)]) + name + struct.pack(">I", len(value)) + value
