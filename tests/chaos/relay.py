"""A bad network between actors and the learner: repeats, delays, cuts, spoils and invents messages."""

from __future__ import annotations

import random
import signal
import time
from collections import Counter
from collections.abc import Callable

import zmq

from giirl import wire
from giirl.wire import PREFIX, WireError

SHARE = 0.02  # of all messages that something happens to
DELAY_S = 0.2
Frames = list[bytes]


def relay(front: int, back: int, seed: int) -> None:
    """Pass on between the two ports of this machine until SIGTERM."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stopped.append(number))
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    context.max_sockets = 1 << 14
    router = context.socket(zmq.ROUTER)
    router.router_handover, router.linger = True, 0
    router.bind(f"tcp://127.0.0.1:{front}")
    poller = zmq.Poller()
    poller.register(router, zmq.POLLIN)
    vandal = Vandal(random.Random(seed))
    lines: dict[bytes, zmq.Socket[bytes]] = {}
    while not stopped:
        ready = dict(poller.poll(20))
        if router in ready:
            peer, *frames = router.recv_multipart()
            if peer not in lines:
                lines[peer] = _line(context, peer, back)
                poller.register(lines[peer], zmq.POLLIN)
            for message in vandal.pass_on(peer, frames):
                lines[peer].send_multipart(message)
        for peer, line in lines.items():
            if line in ready:
                for message in vandal.pass_on(b"", line.recv_multipart()):
                    router.send_multipart([peer, *message])
        for peer, message in vandal.late():
            if peer:
                lines[peer].send_multipart(message)
    context.destroy(linger=0)


def _line(context: zmq.Context[zmq.Socket[bytes]], peer: bytes, back: int) -> zmq.Socket[bytes]:
    line = context.socket(zmq.DEALER)
    line.identity, line.linger = peer, 0
    line.connect(f"tcp://127.0.0.1:{back}")
    return line


class Vandal:
    """Does each kind of harm to some of the messages."""

    def __init__(self, draw: random.Random) -> None:
        self._draw = draw
        self._held: list[tuple[float, bytes, Frames]] = []
        self.done: Counter[str] = Counter()
        self.harms: dict[str, Callable[[Frames], list[Frames]]] = {
            "lost": lambda frames: [],
            "twice": lambda frames: [frames, frames],
            "cut": self._cut,
            "flipped": self._flip,
            "grown": lambda frames: [[*frames, b"x" * 1000]],
            "other_schema": self._other_schema,
            "other_run": self._other_run,
            "junk": lambda frames: [frames, [self._draw.randbytes(40)]],
        }

    def pass_on(self, peer: bytes, frames: Frames) -> list[Frames]:
        if self._draw.random() >= SHARE:
            return [frames]
        kind = self._draw.choice([*self.harms, "late"])
        self.done[kind] += 1
        if kind == "late":
            self._held.append((time.monotonic() + self._draw.random() * DELAY_S, peer, frames))
            return []
        return self.harms[kind](frames)

    def late(self) -> list[tuple[bytes, Frames]]:
        """Those whose time has come, in an order of their own."""
        now_s = time.monotonic()
        due = [(peer, frames) for at_s, peer, frames in self._held if at_s <= now_s]
        self._held = [entry for entry in self._held if entry[0] > now_s]
        self._draw.shuffle(due)
        return due

    def _cut(self, frames: Frames) -> list[Frames]:
        place = self._draw.randrange(len(frames))
        keep = self._draw.randrange(len(frames[place]) + 1)
        return [[*frames[:place], frames[place][:keep]]]

    def _flip(self, frames: Frames) -> list[Frames]:
        place = self._draw.randrange(len(frames))
        spoiled = bytearray(frames[place])
        if spoiled:
            spoiled[self._draw.randrange(len(spoiled))] ^= 1 << self._draw.randrange(8)
        return [[*frames[:place], bytes(spoiled), *frames[place + 1 :]]]

    def _other_schema(self, frames: Frames) -> list[Frames]:
        magic, schema, *rest = PREFIX.unpack_from(frames[0])
        return [[PREFIX.pack(magic, schema + 1, *rest) + frames[0][PREFIX.size :], *frames[1:]]]

    def _other_run(self, frames: Frames) -> list[Frames]:
        """A whole message, as a run of long ago would send it; the true one follows."""
        try:
            header, arrays = wire.decode(frames)
            return [wire.encode({**header, "run": "another"}, arrays), frames] if "run" in header else [frames]
        except WireError:
            return [frames]
