"""The other ends of the benchmarks, in processes of their own: simulated actors that feed a learner, and an echo."""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from giirl_core.types import Action, Episode, Goal, Outcome, Page, Trajectory, Verb
from giirl_core.wire import delivery
from giirl_core.wire import messages as wire
from giirl_core.wire.columns import Columns
from giirl_core.wire.delivery import Notice
from giirl_core.wire.messages import Stamp
from giirl_core.wire.transport import Dealer, Router

ACTORS = 1000
ANSWER_BYTES = 400  # about as many as the rewards of 32 transitions take
END_S = 10.0
BEAT_S = 0.5


def model(steps: int, rows: int, *, seed: int) -> Episode:
    """An episode on pages like real ones: short words that repeat, a few classes, boxes everywhere."""
    rng = np.random.default_rng(seed)
    pages = [_page(rng, rows) for _ in range(steps)]
    trajectory = Trajectory(
        task="click-button",
        goal=Goal('Click on the "Ok" button.'),
        seed=seed,
        pages=tuple(pages),
        actions=tuple(Action(verb=Verb.CLICK, element=0) for _ in pages),
        behaviour_logp=np.full(steps, -0.5, np.float32),
        rewards=np.zeros(steps, np.float32),
        policy_version=0,
    )
    return Episode(trajectory=trajectory, outcome=Outcome(raw_reward=1.0, ended=True))


def _page(rng: np.random.Generator, rows: int) -> Page:
    return Page(
        tag=tuple(("div", "button", "input_text", "t")[n] for n in rng.integers(4, size=rows)),
        text=tuple(f"word {n}" for n in rng.integers(60, size=rows)),
        value=("",) * rows,
        classes=tuple(f"kind-{n} wide" for n in rng.integers(5, size=rows)),
        ref=np.arange(rows, dtype=np.int32),
        parent=np.arange(-1, rows - 1, dtype=np.int16),
        box=rng.random((rows, 4), dtype=np.float32),
        focused=np.zeros(rows, np.bool_),
        tampered=np.zeros(rows, np.bool_),
    )


class Echo:
    """Takes what it gets, and judges nothing: what Ray's side of the benchmarks calls."""

    def take(self, *values: object) -> int:
        return len(values)

    def score(self, header: wire.Header, columns: Columns) -> Columns:
        return no_rewards(columns)

    def echo(self, message: bytes) -> bytes:
        return message[:ANSWER_BYTES]


def no_rewards(columns: Columns) -> Columns:
    """The columns of an answer: zeros, as many as there are steps in a request."""
    return {"steps": columns["steps"], "rewards": np.zeros(len(columns["rows"]), np.float32)}


def score(message: bytes) -> bytes:
    """The same over our wire."""
    header, columns = wire.decode(message)
    return wire.encode({"kind": "scores", "request": header["request"], "version": 1}, no_rewards(columns))


def echo(message: bytes) -> bytes:
    """Nothing but bytes, as many back as an answer has."""
    return message[:ANSWER_BYTES]


class Feed:
    """Tells simulated actors in another process how many episodes to hand over between them."""

    RUN = "bench"

    def __init__(self, orders: Connection) -> None:
        self._orders = orders

    def go(self, episodes: int) -> None:
        self._orders.send_bytes(b"%d" % episodes)

    @classmethod
    def stamp(cls, actor: int, sequence: int) -> Stamp:
        return Stamp(run=cls.RUN, actor=f"actor-{actor}", incarnation=0, sequence=sequence)


class _Line:
    """One simulated actor: no playing, no encoding of pages, no copies kept; but the same messages and credits."""

    def __init__(self, address: str, actor: int) -> None:
        self._actor, self._dealer = actor, Dealer(address, identity=b"actor-%d" % actor)
        self._sent, self._limit, self._notices, self._told_s = 0, 0, 0, 0.0

    def feed(self, header: wire.Header, arrays: Any, wanted: int) -> int:
        """Send as many as the learner takes, `wanted` at most."""
        while (grant := self._dealer.recv(0.0)) is not None:
            self._limit = max(self._limit, delivery.read_grant(wire.decode(grant)[0]).limit)
        if not self._limit and time.monotonic() - self._told_s > BEAT_S:
            self._told_s = time.monotonic()
            notice = Notice(kind=delivery.HELLO, stamp=Feed.stamp(self._actor, 0), number=1, finished=0)
            self._dealer.send(delivery.encode_notice(notice))
        before = self._sent
        while self._sent < self._limit and self._sent - before < wanted:
            stamped = {**header, "actor": f"actor-{self._actor}", "sequence": self._sent}
            if not self._dealer.send(wire.encode(stamped, arrays)):
                break
            self._sent += 1
        return self._sent - before


def _feed(address: str, actors: int, rows: int, orders: Connection) -> None:
    header, arrays = wire.decode(wire.encode_episode(model(10, rows, seed=0), stamp=Feed.stamp(0, 0)))
    lines = [_Line(address, actor) for actor in range(actors)]
    left = 0
    while True:
        if orders.poll(0 if left else 0.05):
            try:
                left += int(orders.recv_bytes())
            except EOFError:
                return
        for line in lines:
            left -= line.feed(header, arrays, left)


def _serve(answer: Callable[[bytes], bytes], orders: Connection) -> None:
    with closing(Router()) as router:
        orders.send_bytes(router.address.encode())
        while True:
            if (received := router.recv(0.5)) is not None:
                peer, message = received
                router.send(peer, answer(message))
            elif orders.poll(0):
                return


@contextmanager
def feeding(address: str, actors: int, rows: int) -> Iterator[Feed]:
    """So many simulated actors that hand over episodes of ten such pages to a learner."""
    with _process(_feed, address, actors, rows) as orders:
        yield Feed(orders)


@contextmanager
def serving(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    """Somebody who answers so; yields the address."""
    with _process(_serve, answer) as orders:
        if not orders.poll(60.0):
            raise TimeoutError("the other end did not start within 60 s")
        yield orders.recv_bytes().decode()


@contextmanager
def _process(work: Any, *values: Any) -> Iterator[Connection]:
    """Started afresh, without what this process has open; ends when the other end of its pipe does."""
    spawn = multiprocessing.get_context("spawn")
    mine, its = spawn.Pipe()
    process = spawn.Process(target=work, args=(*values, its), daemon=True)
    process.start()
    its.close()
    try:
        yield mine
    finally:
        mine.close()
        process.join(END_S)
        if process.is_alive():
            process.kill()
            process.join(END_S)
