"""Cost of message transport: our wire format and sockets compared with memcpy, Ray's object store and Ray actor calls.

The contenders alternate in every round, and the results are medians over rounds, so that a load peak affects all alike.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from contextlib import ExitStack, closing, contextmanager
from typing import Any

import numpy as np

from benchmarks.peers import ACTORS, Echo, SimulatedActors, echo, reply_server, sample_episode, score, simulated_actors
from giirl_core.config_file import load_config
from giirl_core.processes.supervision import Place, Process
from giirl_core.wire import messages as wire
from giirl_core.wire.scoring import encode_request
from giirl_core.wire.transport import Dealer
from learner.stream.flow import IngestLimits
from learner.stream.ingest import Ingest

BIG, SMALL = 215, 20  # rows of a page; an episode of ten pages has 100 KB (more than 100 KiB) or 10 KB
EPISODES = 1000
MESSAGES = 1000  # of 100 KB: more than the CPU cache, because real trajectories are not in the cache either
ROUNDS = 5
WAIT_S = 120.0
Result = dict[str, Any]


def bench_wire() -> Result:
    """Encode and decode messages that are not in the CPU cache, compared with copying as many bytes."""
    messages = [
        wire.encode_episode(sample_episode(10, BIG, seed=n), stamp=SimulatedActors.stamp(0, n)) for n in range(MESSAGES)
    ]
    decoded = [wire.decode(message) for message in messages]
    whole = [bytearray(message) for message in messages]
    times: dict[str, list[float]] = {"encode": [], "decode": [], "memcpy": []}
    for _ in range(ROUNDS):
        for n in range(MESSAGES):
            a, b, c = n, (n + MESSAGES // 3) % MESSAGES, (n + 2 * MESSAGES // 3) % MESSAGES
            times["memcpy"].append(_timed(lambda n=a: bytes(whole[n])))  # type: ignore[misc]
            times["encode"].append(_timed(lambda n=b: wire.encode(*decoded[n])))  # type: ignore[misc]
            times["decode"].append(_timed(lambda n=c: wire.decode(messages[n])))  # type: ignore[misc]
    us = {name: 1e6 * statistics.median(samples) for name, samples in times.items()}
    episode, message = sample_episode(10, BIG, seed=0), messages[0]
    pack = [_timed(lambda: wire.encode_episode(episode, stamp=SimulatedActors.stamp(0, 0))) for _ in range(50)]
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
    """Trajectories of 100 KB per second from another process, compared with passing the same columns to a Ray actor.

    Ours: the sender encodes; the learner's process receives, verifies the checksum, decodes, checks, queues and grants
    credits ("queued"), then also builds episodes and hands them over ("taken").

    Ray's: this process calls an actor that computes nothing, in four ways. "call": header and columns in one call.
    "inlined": each column is an argument of its own, below Ray's limit of 100 KiB for sending it with the call.
    "store": columns are put into the object store first. "bytes": an already encoded message in two halves below that
    limit, the fastest way. The first round is a warm-up and does not count.
    """
    message = wire.encode_episode(sample_episode(10, BIG, seed=0), stamp=SimulatedActors.stamp(0, 0))
    header, columns = wire.decode(message)
    halves = message[: len(message) // 2], message[len(message) // 2 :]
    with (
        _ingest(EPISODES) as ingest,
        simulated_actors(ingest.address, 1, BIG) as actors,
        _ray_peer() as (platform, peer),
    ):
        calls: dict[str, Callable[[], Any]] = {
            "call": lambda: peer.call("take", header, columns),
            "inlined": lambda: peer.call("take", header, *columns.values()),
            "store": lambda: peer.call("take", header, platform.share(columns)),
            "bytes": lambda: peer.call("take", *halves),
        }
        rates: dict[str, list[float]] = {name: [] for name in ("queued", "taken", *calls)}
        for _ in range(ROUNDS + 1):
            since_s = time.perf_counter()
            actors.send(EPISODES)
            while ingest.queued < EPISODES:
                if time.perf_counter() - since_s > WAIT_S:
                    raise TimeoutError(f"the learner received {ingest.queued} of {EPISODES} episodes within {WAIT_S} s")
                time.sleep(0.002)
            rates["queued"].append(EPISODES / (time.perf_counter() - since_s))
            ingest.take(EPISODES, WAIT_S)
            rates["taken"].append(EPISODES / (time.perf_counter() - since_s))
            for name, call in calls.items():
                rates[name].append(_pipelined(call, EPISODES // 5))
    median = {name: statistics.median(samples[1:]) for name, samples in rates.items()}
    return {
        "bytes": len(message),
        "trajectories_per_s": round(median["queued"]),
        "taken_per_s": round(median["taken"]),
        **{f"ray_{name}_per_s": round(median[name]) for name in calls},
        "ratio_ray": round(median["queued"] / median["call"], 1),
        **{f"ratio_ray_{name}": round(median["queued"] / median[name], 1) for name in calls if name != "call"},
    }


def bench_scoring() -> Result:
    """Round trips of a scoring request with 32 transitions. No rewards are computed.

    `p50_ms` is our transport alone: the encoded request, and a reply as long as 32 rewards. "codec" adds encoding and
    decoding on both sides. "ray" is one actor call with the same columns as arguments and as result; Ray's encoding is
    part of the call. "ray_bytes" is an actor call with our encoded request.
    """
    message = encode_request(1, [sample_episode(32, SMALL, seed=0).trajectory])
    header, columns = wire.decode(message)
    with ExitStack() as stack:
        dealers = [
            stack.enter_context(closing(Dealer(stack.enter_context(reply_server(reply)), identity=b"bench")))
            for reply in (score, echo)
        ]
        _, peer = stack.enter_context(_ray_peer())

        def round_trip(dealer: Dealer, request: bytes) -> bytes:
            if not dealer.send(request, WAIT_S) or (reply := dealer.recv(WAIT_S)) is None:
                raise TimeoutError(f"no reply from {dealer.address} within {WAIT_S} s")
            return reply

        calls: dict[str, Callable[[], object]] = {
            "ours": lambda: round_trip(dealers[1], message),
            "codec": lambda: wire.decode(round_trip(dealers[0], wire.encode(header, columns))),
            "ray": lambda: peer.call("score", header, columns).result(WAIT_S),
            "ray_bytes": lambda: peer.call("echo", message).result(WAIT_S),
        }
        times: dict[str, list[float]] = {name: [] for name in calls}
        for number in range(10 * ROUNDS + 2):
            for name, work in calls.items():
                seconds = [_timed(work) for _ in range(20)]
                if number >= 2:  # the first rounds are a warm-up
                    times[name] += seconds
    p50 = {name: 1e3 * statistics.median(samples) for name, samples in times.items()}
    p99 = {name: 1e3 * float(np.quantile(samples, 0.99)) for name, samples in times.items()}
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
    """The learner's CPU time per trajectory of 10 KB, with ten simulated actors and with a thousand.

    One after the other: a thousand waiting actors still send heartbeats, which would add to the cost of the ten.
    """
    cost: dict[int, list[float]] = {10: [], ACTORS: []}
    for _ in range(3):
        for actors in cost:
            with _ingest() as ingest, simulated_actors(ingest.address, actors, SMALL) as senders:
                for number in range(4):
                    senders.send(ACTORS)
                    since_s = time.process_time()
                    for _ in range(ACTORS // 40):
                        ingest.take(40, WAIT_S)
                    if number:  # in the first round the actors connect
                        cost[actors].append((time.process_time() - since_s) / ACTORS)
    us = {actors: 1e6 * statistics.median(samples) for actors, samples in cost.items()}
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


def _ingest(credits_: int = 4) -> Any:
    limits = IngestLimits(credits=credits_, max_bytes=1 << 30)
    return closing(Ingest(SimulatedActors.RUN, lambda: 0, limits=limits))


def _pipelined(call: Callable[[], Any], count: int, ahead: int = 32) -> float:
    """Calls per second, with `ahead` calls in flight."""
    since_s, in_flight = time.perf_counter(), []
    for _ in range(count):
        in_flight.append(call())
        if len(in_flight) == ahead:
            in_flight.pop(0).result(WAIT_S)
    for pending in in_flight:
        pending.result(WAIT_S)
    return count / (time.perf_counter() - since_s)


@contextmanager
def _ray_peer() -> Any:
    """Start Ray on this machine with one Echo actor. Yields the platform and the actor."""
    from giirl_core.processes.ray_platform import RayPlatform

    os.environ.setdefault("RAY_worker_niceness", "0")  # Ray's default of 15 would slow its workers on a busy machine
    platform = RayPlatform(load_config(None, ["runtime=local", "actors.count=1"]), "bench")
    try:
        peer: Process = platform.start(Echo, "echo", place=Place(), threads=1)
        peer.call("take").result(WAIT_S)
        yield platform, peer
    finally:
        platform.close()
