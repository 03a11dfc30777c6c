"""Peer processes for the transport benchmarks: simulated actors that send episodes, and servers that reply."""

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
REPLY_BYTES = 400  # about the size of the rewards of 32 transitions
SHUTDOWN_S = 10.0
HELLO_INTERVAL_S = 0.5


def sample_episode(steps: int, rows: int, *, seed: int) -> Episode:
    """An episode of `steps` pages with `rows` rows each. Like real pages: short repeated words, few CSS classes."""
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
    """The Ray actor of the benchmarks. It computes nothing."""

    def take(self, *values: object) -> int:
        """Receive values of any kind."""
        return len(values)

    def score(self, header: wire.Header, columns: Columns) -> Columns:
        """Reply to a scoring request with zero rewards."""
        return zero_rewards(columns)

    def echo(self, message: bytes) -> bytes:
        """Reply with as many bytes as a real reply has."""
        return message[:REPLY_BYTES]


def zero_rewards(columns: Columns) -> Columns:
    """The columns of a reply: one zero for each step of the request."""
    return {"steps": columns["steps"], "rewards": np.zeros(len(columns["rows"]), np.float32)}


def score(message: bytes) -> bytes:
    """Reply to an encoded scoring request with an encoded reply of zero rewards."""
    header, columns = wire.decode(message)
    return wire.encode({"kind": "scores", "request": header["request"], "version": 1}, zero_rewards(columns))


def echo(message: bytes) -> bytes:
    """Reply with as many bytes as a real reply has, without decoding."""
    return message[:REPLY_BYTES]


class SimulatedActors:
    """Controls simulated actors in another process."""

    RUN = "bench"

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def send(self, episodes: int) -> None:
        """Let the actors together send `episodes` more episodes."""
        self._pipe.send_bytes(b"%d" % episodes)

    @classmethod
    def stamp(cls, actor: int, sequence: int) -> Stamp:
        """The stamp of an episode of one of the actors."""
        return Stamp(run=cls.RUN, actor=f"actor-{actor}", incarnation=0, sequence=sequence)


class _SimulatedActor:
    """One actor with the real messages and credits, but without playing, encoding pages or keeping copies."""

    def __init__(self, address: str, actor: int) -> None:
        self._actor, self._dealer = actor, Dealer(address, identity=b"actor-%d" % actor)
        self._sent, self._limit, self._hello_s = 0, 0, 0.0

    def feed(self, header: wire.Header, arrays: Any, wanted: int) -> int:
        """Send as many episodes as the learner's credits allow, at most `wanted`. Returns how many."""
        while (grant := self._dealer.recv(0.0)) is not None:
            self._limit = max(self._limit, delivery.read_grant(wire.decode(grant)[0]).limit)
        if not self._limit and time.monotonic() - self._hello_s > HELLO_INTERVAL_S:
            self._hello_s = time.monotonic()
            notice = Notice(kind=delivery.HELLO, stamp=SimulatedActors.stamp(self._actor, 0), number=1, finished=0)
            self._dealer.send(delivery.encode_notice(notice))
        before = self._sent
        while self._sent < self._limit and self._sent - before < wanted:
            stamped = {**header, "actor": f"actor-{self._actor}", "sequence": self._sent}
            if not self._dealer.send(wire.encode(stamped, arrays)):
                break
            self._sent += 1
        return self._sent - before


def _run_actors(address: str, actors: int, rows: int, pipe: Connection) -> None:
    episode = sample_episode(10, rows, seed=0)
    header, arrays = wire.decode(wire.encode_episode(episode, stamp=SimulatedActors.stamp(0, 0)))
    simulated = [_SimulatedActor(address, actor) for actor in range(actors)]
    left = 0
    while True:
        if pipe.poll(0 if left else 0.05):
            try:
                left += int(pipe.recv_bytes())
            except EOFError:
                return
        for actor in simulated:
            left -= actor.feed(header, arrays, left)


def _run_server(reply: Callable[[bytes], bytes], pipe: Connection) -> None:
    with closing(Router()) as router:
        pipe.send_bytes(router.address.encode())
        while True:
            if (received := router.recv(0.5)) is not None:
                peer, message = received
                router.send(peer, reply(message))
            elif pipe.poll(0):
                return


@contextmanager
def simulated_actors(address: str, actors: int, rows: int) -> Iterator[SimulatedActors]:
    """Start `actors` simulated actors that send episodes of ten pages with `rows` rows to a learner at `address`."""
    with _process(_run_actors, address, actors, rows) as pipe:
        yield SimulatedActors(pipe)


@contextmanager
def reply_server(reply: Callable[[bytes], bytes]) -> Iterator[str]:
    """Start a server that replies with `reply(message)`. Yields its address. TimeoutError if it does not start."""
    with _process(_run_server, reply) as pipe:
        if not pipe.poll(60.0):
            raise TimeoutError("the server process did not start within 60 s")
        yield pipe.recv_bytes().decode()


@contextmanager
def _process(target: Any, *args: Any) -> Iterator[Connection]:
    """Run a function in a spawned process, which inherits no open files. It ends when its pipe is closed."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=target, args=(*args, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        yield ours
    finally:
        ours.close()
        process.join(SHUTDOWN_S)
        if process.is_alive():
            process.kill()
            process.join(SHUTDOWN_S)
