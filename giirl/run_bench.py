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

from giirl import wire
from giirl.config_file import load_config
from giirl.run_bench_peers import ACTORS, Echo, Feed, feeding, model, serving
from giirl.scoring import encode_request
from giirl.supervision import Process
from giirl.transport import Dealer
from learner.admission import IngestLimits
from learner.ingest import Ingest

BIG, SMALL = 200, 20  # rows of a page: an episode of ten such is 100 KB, or 10
COLD = 1000  # messages of 100 KB: more than a cache holds, as trajectories are when their turn comes
ROUNDS = 5
WAIT_S = 120.0
Result = dict[str, Any]


def bench_wire() -> Result:
    """Columns to frames and back, once per message and none of them in a cache, against copying as many bytes."""
    frames = [wire.encode_episode(model(10, BIG, seed=n), stamp=Feed.stamp(0, n)) for n in range(COLD)]
    decoded = [wire.decode(message) for message in frames]
    whole = [bytearray(b"".join(message)) for message in frames]
    taken: dict[str, list[float]] = {"encode": [], "decode": [], "memcpy": []}
    for _ in range(ROUNDS):
        for n in range(COLD):
            a, b, c = n, (n + COLD // 3) % COLD, (n + 2 * COLD // 3) % COLD
            taken["memcpy"].append(_timed(lambda n=a: bytes(whole[n])))  # type: ignore[misc]
            taken["encode"].append(_timed(lambda n=b: wire.encode(*decoded[n])))  # type: ignore[misc]
            taken["decode"].append(_timed(lambda n=c: wire.decode(frames[n])))  # type: ignore[misc]
    us = {name: 1e6 * statistics.median(some) for name, some in taken.items()}
    episode, message = model(10, BIG, seed=0), frames[0]
    pack = [_timed(lambda: wire.encode_episode(episode, stamp=Feed.stamp(0, 0))) for _ in range(50)]
    build = [_timed(lambda: wire.decode_episode(message)) for _ in range(50)]
    return {
        "bytes": sum(map(len, message)),
        "encode_us": round(us["encode"], 1),
        "decode_us": round(us["decode"], 1),
        "memcpy_us": round(us["memcpy"], 1),
        "ratio_memcpy": round((us["encode"] + us["decode"]) / us["memcpy"], 2),
        "episode_to_frames_us": round(1e6 * statistics.median(pack), 1),
        "frames_to_episode_us": round(1e6 * statistics.median(build), 1),
    }


def bench_ingest() -> Result:
    """Episodes of 100 KB from another process until they are verified and queued, or taken, per second."""
    ours, taken, calls, store = [], [], [], []
    frames = wire.encode_episode(model(10, BIG, seed=0), stamp=Feed.stamp(0, 0))
    with _ray_peer() as (platform, peer):
        for _ in range(ROUNDS):
            queued_s, taken_s = _stream(episodes=400)
            ours.append(400 / queued_s)
            taken.append(400 / taken_s)
            calls.append(_pipelined(lambda: peer.call("take", frames), 150))
            store.append(_pipelined(lambda: peer.call("take", platform.share(frames)), 150))
    rates = {name: statistics.median(some) for name, some in (("ray", calls), ("store", store), ("ours", ours))}
    return {
        "bytes": sum(map(len, frames)),
        "trajectories_per_s": round(rates["ours"]),
        "taken_per_s": round(statistics.median(taken)),
        "ray_call_per_s": round(rates["ray"]),
        "ray_store_per_s": round(rates["store"]),
        "ratio_ray": round(rates["ours"] / rates["ray"], 1),
        "ratio_ray_store": round(rates["ours"] / rates["store"], 1),
    }


def bench_scoring() -> Result:
    """Round trips of a request with 32 transitions and its answer, transport alone: nobody scores anything."""
    request = encode_request(1, [model(1, SMALL, seed=n).trajectory for n in range(32)])
    reply = Echo().answer(request)
    ours: list[float] = []
    ray: list[float] = []
    with serving(reply) as address, closing(Dealer(address, identity=b"bench")) as dealer, _ray_peer() as (_, peer):

        def ask() -> None:
            if not dealer.send(request, WAIT_S) or dealer.recv(WAIT_S) is None:
                raise TimeoutError(f"no answer of {address} within {WAIT_S} s")

        for _ in range(20):
            ask()
            peer.call("answer", request).result(WAIT_S)
        for _ in range(40 * ROUNDS):
            ours += [_timed(ask) for _ in range(4)]
            ray.append(_timed(lambda: peer.call("answer", request).result(WAIT_S)))
    return {
        "request_bytes": sum(map(len, request)),
        "p50_ms": round(1e3 * statistics.median(ours), 3),
        "p99_ms": round(1e3 * float(np.quantile(ours, 0.99)), 3),
        "ray_p50_ms": round(1e3 * statistics.median(ray), 3),
        "ray_p99_ms": round(1e3 * float(np.quantile(ray, 0.99)), 3),
        "ratio_ray": round(statistics.median(ray) / statistics.median(ours), 1),
    }


def bench_scale() -> Result:
    """The learner's processor time per trajectory of 10 KB, with ten simulated actors and with a thousand."""
    cost: dict[int, list[float]] = {10: [], ACTORS: []}
    with ExitStack() as open_things:
        sides = []
        for actors in cost:
            ingest = open_things.enter_context(_hearing())
            sides.append((actors, ingest, open_things.enter_context(feeding(ingest.address, actors, SMALL))))
        for number in range(ROUNDS + 1):
            for actors, ingest, feed in sides:
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


def _stream(episodes: int) -> tuple[float, float]:
    """Seconds until so many are verified and queued; and until all of them are taken, too."""
    with _hearing(credits_=episodes) as ingest, feeding(ingest.address, 1, BIG) as feed:
        feed.go(1)
        ingest.take(1, WAIT_S)  # everybody is there
        since_s = time.perf_counter()
        feed.go(episodes)
        while ingest.queued < episodes:
            if time.perf_counter() - since_s > WAIT_S:
                raise TimeoutError(f"{ingest.queued} of {episodes} episodes within {WAIT_S} s")
            time.sleep(0.002)
        queued_s = time.perf_counter() - since_s
        ingest.take(episodes, WAIT_S)
        return queued_s, time.perf_counter() - since_s


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
    from giirl.run_ray import RayPlatform

    os.environ.setdefault("RAY_worker_niceness", "0")  # Ray takes 15, which alone decides on a busy machine
    platform = RayPlatform(load_config(None, ["runtime=local", "actors.count=1"]), "bench")
    try:
        peer: Process = platform.start("echo", "echo", 0)
        peer.call("take", []).result(WAIT_S)
        yield platform, peer
    finally:
        platform.close()
