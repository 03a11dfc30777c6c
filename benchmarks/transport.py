"""What moving bytes costs: our wire and sockets against memcpy, Ray's object store and Ray's actor calls, in turn.

Contenders follow each other in every round and figures are medians over rounds: a busy machine slows them alike.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, contextmanager
from typing import Any

import numpy as np

from benchmarks.peers import ACTORS, Echo, Feed, echo, feeding, model, score, serving
from giirl_core.config_file import load_config
from giirl_core.processes.supervision import Process
from giirl_core.wire import messages as wire
from giirl_core.wire.scoring import encode_request
from giirl_core.wire.transport import Dealer
from learner.stream.admission import IngestLimits
from learner.stream.ingest import Ingest

BIG, SMALL = 215, 20  # rows of a page: an episode of ten such is 100 KB (and more than 100 KiB), or 10
EPISODES = 1000
COLD = 1000  # messages of 100 KB: more than a cache holds, as trajectories are when their turn comes
ROUNDS = 5
WAIT_S = 120.0
Result = dict[str, Any]


def bench_wire() -> Result:
    """Columns to a message and back, once per message and none of them in a cache, against copying as many bytes."""
    messages = [wire.encode_episode(model(10, BIG, seed=n), stamp=Feed.stamp(0, n)) for n in range(COLD)]
    decoded = [wire.decode(message) for message in messages]
    whole = [bytearray(message) for message in messages]
    taken: dict[str, list[float]] = {"encode": [], "decode": [], "memcpy": []}
    for _ in range(ROUNDS):
        for n in range(COLD):
            a, b, c = n, (n + COLD // 3) % COLD, (n + 2 * COLD // 3) % COLD
            taken["memcpy"].append(_timed(lambda n=a: bytes(whole[n])))  # type: ignore[misc]
            taken["encode"].append(_timed(lambda n=b: wire.encode(*decoded[n])))  # type: ignore[misc]
            taken["decode"].append(_timed(lambda n=c: wire.decode(messages[n])))  # type: ignore[misc]
    us = {name: 1e6 * statistics.median(some) for name, some in taken.items()}
    episode, message = model(10, BIG, seed=0), messages[0]
    pack = [_timed(lambda: wire.encode_episode(episode, stamp=Feed.stamp(0, 0))) for _ in range(50)]
    build = [_timed(lambda: wire.decode_episode(message)) for _ in range(50)]
    return {
        "bytes": len(message),
        "encode_us": round(us["encode"], 1),
        "decode_us": round(us["decode"], 1),
        "memcpy_us": round(us["memcpy"], 1),
        "ratio_memcpy": round((us["encode"] + us["decode"]) / us["memcpy"], 2),
        "episode_to_message_us": round(1e6 * statistics.median(pack), 1),
        "message_to_episode_us": round(1e6 * statistics.median(build), 1),
    }


def bench_ingest() -> Result:
    """Trajectories of 100 KB from another process, per second, against handing the same columns to a Ray actor.

    Ours are encoded by the one process, and by the learner's received, checked against their checksum, decoded, judged,
    queued and granted ("taken": built into episodes and handed over, too). Ray's are given by this process to an actor
    that does nothing: header and columns in one call, as anybody would; also with each column an argument of its own,
    which Ray then sends along with the call because each is below its limit of 100 KiB; also put into the object store
    first; also as bytes that somebody has encoded already, in two halves below that limit, which is as fast as Ray
    gets. The first round, in which memory is new to the processes, is not counted for either.
    """
    message = wire.encode_episode(model(10, BIG, seed=0), stamp=Feed.stamp(0, 0))
    header, columns = wire.decode(message)
    halves = message[: len(message) // 2], message[len(message) // 2 :]
    with _hearing(EPISODES) as ingest, feeding(ingest.address, 1, BIG) as feed, _ray_peer() as (platform, peer):
        ways: dict[str, Callable[[], Any]] = {
            "call": lambda: peer.call("take", header, columns),
            "inlined": lambda: peer.call("take", header, *columns.values()),
            "store": lambda: peer.call("take", header, platform.share(columns)),
            "bytes": lambda: peer.call("take", *halves),
        }
        rates: dict[str, list[float]] = {name: [] for name in ("queued", "taken", *ways)}
        for _ in range(ROUNDS + 1):
            since_s = time.perf_counter()
            feed.go(EPISODES)
            while ingest.queued < EPISODES:
                if time.perf_counter() - since_s > WAIT_S:
                    raise TimeoutError(f"{ingest.queued} of {EPISODES} episodes within {WAIT_S} s")
                time.sleep(0.002)
            rates["queued"].append(EPISODES / (time.perf_counter() - since_s))
            ingest.take(EPISODES, WAIT_S)
            rates["taken"].append(EPISODES / (time.perf_counter() - since_s))
            for name, call in ways.items():
                rates[name].append(_pipelined(call, EPISODES // 5))
    median = {name: statistics.median(some[1:]) for name, some in rates.items()}
    return {
        "bytes": len(message),
        "trajectories_per_s": round(median["queued"]),
        "taken_per_s": round(median["taken"]),
        **{f"ray_{name}_per_s": round(median[name]) for name in ways},
        "ratio_ray": round(median["queued"] / median["call"], 1),
        **{f"ratio_ray_{name}": round(median["queued"] / median[name], 1) for name in ways if name != "call"},
    }


def bench_scoring() -> Result:
    """Round trips of a trajectory of 32 transitions and its answer; nobody scores anything.

    `p50_ms` is our transport alone: the encoded request and an answer as long as 32 rewards. Ray's is one call of an
    actor with the same columns as arguments and as result, what anybody would write; its encoding is part of a call.
    "codec": ours with encoding and decoding on both sides, from columns to columns as Ray's. "bytes": Ray given the
    request that we have encoded.
    """
    message = encode_request(1, [model(32, SMALL, seed=0).trajectory])
    header, columns = wire.decode(message)
    with ExitStack() as open_things:
        dealers = [
            open_things.enter_context(closing(Dealer(open_things.enter_context(serving(answer)), identity=b"bench")))
            for answer in (score, echo)
        ]
        _, peer = open_things.enter_context(_ray_peer())

        def ask(dealer: Dealer, request: bytes) -> bytes:
            if not dealer.send(request, WAIT_S) or (answer := dealer.recv(WAIT_S)) is None:
                raise TimeoutError(f"no answer of {dealer.address} within {WAIT_S} s")
            return answer

        ways: dict[str, Callable[[], object]] = {
            "ours": lambda: ask(dealers[1], message),
            "codec": lambda: wire.decode(ask(dealers[0], wire.encode(header, columns))),
            "ray": lambda: peer.call("score", header, columns).result(WAIT_S),
            "ray_bytes": lambda: peer.call("echo", message).result(WAIT_S),
        }
        taken: dict[str, list[float]] = {name: [] for name in ways}
        for number in range(10 * ROUNDS + 2):
            for name, work in ways.items():
                seconds = [_timed(work) for _ in range(20)]
                if number >= 2:
                    taken[name] += seconds
    p50 = {name: 1e3 * statistics.median(some) for name, some in taken.items()}
    p99 = {name: 1e3 * float(np.quantile(some, 0.99)) for name, some in taken.items()}
    return {
        "request_bytes": len(message),
        "p50_ms": round(p50["ours"], 3),
        "p99_ms": round(p99["ours"], 3),
        "codec_p50_ms": round(p50["codec"], 3),
        "ray_p50_ms": round(p50["ray"], 3),
        "ray_p99_ms": round(p99["ray"], 3),
        "ray_bytes_p50_ms": round(p50["ray_bytes"], 3),
        "ratio_ray": round(p50["ray"] / p50["ours"], 1),
        "ratio_ray_codec": round(p50["ray"] / p50["codec"], 1),
        "ratio_ray_bytes": round(p50["ray_bytes"] / p50["ours"], 1),
    }


def bench_scale() -> Result:
    """The learner's processor time per trajectory of 10 KB, with ten simulated actors and with a thousand.

    Never both at once: a thousand who wait still send heartbeats, which would count as the cost of the ten.
    """
    cost: dict[int, list[float]] = {10: [], ACTORS: []}
    for _ in range(3):
        for actors in cost:
            with _hearing() as ingest, feeding(ingest.address, actors, SMALL) as feed:
                for number in range(4):
                    feed.go(ACTORS)
                    since_s = time.process_time()
                    for _ in range(ACTORS // 40):
                        ingest.take(40, WAIT_S)
                    if number:  # the first is for everybody to say hello
                        cost[actors].append((time.process_time() - since_s) / ACTORS)
    us = {actors: 1e6 * statistics.median(some) for actors, some in cost.items()}
    return {
        "actors": ACTORS,
        "us_at_10": round(us[10], 1),
        "us_at_1000": round(us[ACTORS], 1),
        "cost_ratio_1000_to_10": round(us[ACTORS] / us[10], 2),
    }


BENCHES: dict[str, Callable[[], Result]] = {
    "wire": bench_wire,
    "scoring": bench_scoring,
    "ingest": bench_ingest,
    "scale": bench_scale,
}


def _timed(work: Callable[[], object]) -> float:
    since_s = time.perf_counter()
    work()
    return time.perf_counter() - since_s


def _hearing(credits_: int = 4) -> Any:
    limits = IngestLimits(credits=credits_, max_bytes=1 << 30)
    return closing(Ingest(Feed.RUN, lambda: 0, limits=limits))


def _pipelined(call: Callable[[], Any], count: int, ahead: int = 32) -> float:
    """Calls per second, with so many under way at a time."""
    since_s, under_way = time.perf_counter(), []
    for _ in range(count):
        under_way.append(call())
        if len(under_way) == ahead:
            under_way.pop(0).result(WAIT_S)
    for answer in under_way:
        answer.result(WAIT_S)
    return count / (time.perf_counter() - since_s)


@contextmanager
def _ray_peer() -> Any:
    """Ray on this machine, and an actor of it that takes and answers."""
    from giirl_core.processes.ray_platform import RayPlatform

    os.environ.setdefault("RAY_worker_niceness", "0")  # Ray takes 15, which alone decides on a busy machine
    platform = RayPlatform(load_config(None, ["runtime=local", "actors.count=1"]), "bench")
    try:
        peer: Process = platform.start(Echo, "echo", cpus=0, threads=1)
        peer.call("take").result(WAIT_S)
        yield platform, peer
    finally:
        platform.close()
