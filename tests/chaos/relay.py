"""A bad network between actors and the learner: repeats, delays, cuts, spoils and invents messages."""

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

SHARE = 0.02  # of all messages that something happens to
DELAY_S = 0.2
BURST = 200  # messages of actors between two looks at what the learner has to say
IDLE_S = 5.0  # an actor says something far more often: one that does not is gone


def relay(front: int, back: int, seed: int, harms: Path) -> None:
    """Pass on between the two ports of this machine until SIGTERM; then tell what harm was done."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stopped.append(number))
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    context.max_sockets = 1 << 14
    router = context.socket(zmq.ROUTER)
    router.router_handover, router.linger = True, 0
    router.bind(f"tcp://127.0.0.1:{front}")
    lines = _Lines(context, router, back)
    vandal = Vandal(random.Random(seed))
    while not stopped:
        told = lines.poll()
        for _ in range(BURST):
            try:
                peer, message = router.recv_multipart(zmq.DONTWAIT)
            except zmq.Again:
                break
            for passed in vandal.pass_on(peer, message):
                lines.of(peer).send(passed)
        for peer in told:
            for passed in vandal.pass_on(b"", lines.of(peer).recv()):
                router.send_multipart([peer, passed])
        for peer, message in vandal.late():
            if peer:
                lines.of(peer).send(message)
    context.destroy(linger=0)
    harms.write_text(json.dumps(vandal.done))


class _Lines:
    """To the learner, one for each actor that says something."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], router: zmq.Socket[bytes], back: int) -> None:
        self._context, self._back = context, back
        self._poller = zmq.Poller()
        self._poller.register(router, zmq.POLLIN)
        self._lines: dict[bytes, zmq.Socket[bytes]] = {}
        self._used_s: dict[bytes, float] = {}

    def of(self, peer: bytes) -> zmq.Socket[bytes]:
        self._used_s[peer] = time.monotonic()
        if peer not in self._lines:
            line = self._lines[peer] = self._context.socket(zmq.DEALER)
            line.identity, line.linger = peer, 0
            line.connect(f"tcp://127.0.0.1:{self._back}")
            self._poller.register(line, zmq.POLLIN)
        return self._lines[peer]

    def poll(self) -> list[bytes]:
        """Whom the learner tells something. Lines of those who are gone are closed."""
        now_s = time.monotonic()
        for peer in [peer for peer, used_s in self._used_s.items() if now_s - used_s > IDLE_S]:
            self._poller.unregister(self._lines[peer])
            self._lines.pop(peer).close()
            del self._used_s[peer]
        ready = dict(self._poller.poll(20))
        return [peer for peer, line in self._lines.items() if line in ready]


class Vandal:
    """Does each kind of harm to some of the messages."""

    def __init__(self, rng: random.Random) -> None:
        self._rng = rng
        self._held: list[tuple[float, bytes, bytes]] = []
        self.done: Counter[str] = Counter()
        self.harms: dict[str, Callable[[bytes], list[bytes]]] = {
            "lost": lambda message: [],
            "twice": lambda message: [message, message],
            "cut": self._cut,
            "flipped": self._flip,
            "grown": lambda message: [message + b"x" * 1000],
            "other_schema": self._other_schema,
            "other_run": self._other_run,
            "junk": lambda message: [message, self._rng.randbytes(40)],
        }

    def pass_on(self, peer: bytes, message: bytes) -> list[bytes]:
        if self._rng.random() >= SHARE:
            return [message]
        kind = self._rng.choice([*self.harms, "late"])
        self.done[kind] += 1
        if kind == "late":
            self._held.append((time.monotonic() + self._rng.random() * DELAY_S, peer, message))
            return []
        return self.harms[kind](message)

    def late(self) -> list[tuple[bytes, bytes]]:
        """Those whose time has come, in an order of their own."""
        now_s = time.monotonic()
        due = [(peer, message) for at_s, peer, message in self._held if at_s <= now_s]
        self._held = [entry for entry in self._held if entry[0] > now_s]
        self._rng.shuffle(due)
        return due

    def _cut(self, message: bytes) -> list[bytes]:
        return [message[: self._rng.randrange(len(message))]]

    def _flip(self, message: bytes) -> list[bytes]:
        spoiled = bytearray(message)
        spoiled[self._rng.randrange(len(spoiled))] ^= 1 << self._rng.randrange(8)
        return [bytes(spoiled)]

    def _other_schema(self, message: bytes) -> list[bytes]:
        magic, schema, promised = PREFIX.unpack_from(message)
        return [PREFIX.pack(magic, schema + 1, promised) + message[PREFIX.size :]]

    def _other_run(self, message: bytes) -> list[bytes]:
        """A whole message, as a run of long ago would send it; the true one follows."""
        header, arrays = wire.decode(message)
        return [wire.encode({**header, "run": "another"}, arrays), message] if "run" in header else [message]
