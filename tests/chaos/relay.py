"""A relay that simulates a bad network between actors and learner: it loses, repeats, delays and corrupts messages."""

from __future__ import annotations

import json
import random
import signal
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import zmq

from giirl_core.wire import messages as wire
from giirl_core.wire.messages import PREFIX

FAULT_PROB = 0.02  # per message
MAX_DELAY_S = 0.2
BURST = 200  # messages from actors before the learner's messages are relayed
IDLE_S = 5.0  # a longer silence means that the actor has ended: heartbeats are far more frequent


def relay(front: int, back: int, seed: int, faults_file: Path) -> None:
    """Relay between two ports of this machine until SIGTERM, then write the number of faults of each kind."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda signum, frame: stopped.append(signum))
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    context.max_sockets = 1 << 14
    router = context.socket(zmq.ROUTER)
    router.router_handover, router.linger = True, 0
    router.bind(f"tcp://127.0.0.1:{front}")
    connections = _Connections(context, router, back)
    faults = FaultInjector(random.Random(seed))
    while not stopped:
        readable = connections.poll()
        for _ in range(BURST):
            try:
                peer, message = router.recv_multipart(zmq.DONTWAIT)
            except zmq.Again:
                break
            for forwarded in faults.apply(peer, message):
                connections.of(peer).send(forwarded)
        for peer in readable:
            for forwarded in faults.apply(b"", connections.of(peer).recv()):
                router.send_multipart([peer, forwarded])
        for peer, message in faults.due():
            if peer:
                connections.of(peer).send(message)
    context.destroy(linger=0)
    faults_file.write_text(json.dumps(faults.counts))


class _Connections:
    """One connection to the learner for each actor."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], router: zmq.Socket[bytes], back: int) -> None:
        self._context, self._back = context, back
        self._poller = zmq.Poller()
        self._poller.register(router, zmq.POLLIN)
        self._sockets: dict[bytes, zmq.Socket[bytes]] = {}
        self._used_s: dict[bytes, float] = {}

    def of(self, peer: bytes) -> zmq.Socket[bytes]:
        self._used_s[peer] = time.monotonic()
        if peer not in self._sockets:
            socket = self._sockets[peer] = self._context.socket(zmq.DEALER)
            socket.identity, socket.linger = peer, 0
            socket.connect(f"tcp://127.0.0.1:{self._back}")
            self._poller.register(socket, zmq.POLLIN)
        return self._sockets[peer]

    def poll(self) -> list[bytes]:
        """The actors for which the learner has sent something. Also closes the connections of ended actors."""
        now_s = time.monotonic()
        for peer in [peer for peer, used_s in self._used_s.items() if now_s - used_s > IDLE_S]:
            self._poller.unregister(self._sockets[peer])
            self._sockets.pop(peer).close()
            del self._used_s[peer]
        ready = dict(self._poller.poll(20))
        return [peer for peer, socket in self._sockets.items() if socket in ready]


class FaultInjector:
    """Loses, repeats, delays or corrupts some of the messages."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._delayed: list[tuple[float, bytes, bytes]] = []
        self.counts: Counter[str] = Counter()
        self._faults: dict[str, Callable[[bytes], list[bytes]]] = {
            "lost": lambda message: [],
            "twice": lambda message: [message, message],
            "cut": self._cut,
            "flipped": self._flip,
            "grown": lambda message: [message + b"x" * 1000],
            "other_schema": self._other_schema,
            "other_run": self._other_run,
            "junk": lambda message: [message, self._rng.randbytes(40)],
        }

    def apply(self, peer: bytes, message: bytes) -> list[bytes]:
        """The messages to forward now instead of this one."""
        if self._rng.random() >= FAULT_PROB:
            return [message]
        kind = self._rng.choice([*self._faults, "late"])
        self.counts[kind] += 1
        if kind == "late":
            self._delayed.append((time.monotonic() + self._rng.random() * MAX_DELAY_S, peer, message))
            return []
        return self._faults[kind](message)

    def due(self) -> list[tuple[bytes, bytes]]:
        """(peer, message) for delayed messages whose time has come, in random order."""
        now_s = time.monotonic()
        due = [(peer, message) for at_s, peer, message in self._delayed if at_s <= now_s]
        self._delayed = [entry for entry in self._delayed if entry[0] > now_s]
        self._rng.shuffle(due)
        return due

    def _cut(self, message: bytes) -> list[bytes]:
        return [message[: self._rng.randrange(len(message))]]

    def _flip(self, message: bytes) -> list[bytes]:
        corrupted = bytearray(message)
        corrupted[self._rng.randrange(len(corrupted))] ^= 1 << self._rng.randrange(8)
        return [bytes(corrupted)]

    def _other_schema(self, message: bytes) -> list[bytes]:
        magic, schema, checksum = PREFIX.unpack_from(message)
        return [PREFIX.pack(magic, schema + 1, checksum) + message[PREFIX.size :]]

    def _other_run(self, message: bytes) -> list[bytes]:
        """A valid message from another run, then the original one."""
        header, arrays = wire.decode(message)
        return [wire.encode({**header, "run": "another"}, arrays), message] if "run" in header else [message]
