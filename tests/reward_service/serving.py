"""A reward service that runs in a thread during a test, and functions that wait with a timeout."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from actors.uplink import Uplink
from giirl_core.metrics import Metrics
from giirl_core.types import Trajectory
from giirl_core.weights import Weights
from giirl_core.wire import messages as wire
from giirl_core.wire import scoring
from giirl_core.wire.score_client import ScoreClient
from giirl_core.wire.transport import Router
from reward_service.service import RewardService, Scorer
from tests.giirl_core.wire_examples import episode

WAIT_S = 20.0
T = TypeVar("T")
Rewards = NDArray[np.float32]


def load(weights: Weights) -> Scorer:
    """The reward of every step is the number in the blob."""
    if not weights.blob.isdigit():
        raise ValueError(f"{weights.blob!r} is no number")
    number = float(weights.blob)
    return lambda trajectories: [np.full(len(t), number, np.float32) for t in trajectories]


def trajectory(steps: int = 2) -> Trajectory:
    return episode(steps).trajectory


@contextmanager
def serving(service: RewardService) -> Iterator[RewardService]:
    """The service, while it serves in a thread."""
    stop = threading.Event()
    thread = threading.Thread(target=service.serve, args=(stop.is_set,))
    thread.start()
    try:
        yield service
    finally:
        stop.set()
        thread.join(WAIT_S)
        assert not thread.is_alive()


def counted(metrics: Metrics, result: str) -> float:
    """The number of score requests with this result."""
    return metrics.registry.get_sample_value("giirl_scoring_requests_total", {"result": result}) or 0.0


def poll_results(client: ScoreClient, count: int = 1) -> list[tuple[object, Rewards | None, int]]:
    """Poll until there are `count` results: (key, rewards, version)."""
    found: list[tuple[object, Rewards | None, int]] = []
    deadline_s = time.monotonic() + WAIT_S
    while len(found) < count and time.monotonic() < deadline_s:
        found += client.poll()
        time.sleep(0.002)
    return found


def receive_request(client: ScoreClient, router: Router) -> tuple[bytes, int]:
    """Wait for a request at a router that stands in for a replica; returns the peer and the request number."""
    peer, message = until(lambda: router.recv(0.0) if not client.poll() else None)
    return peer, scoring.read_request(wire.decode(message)[0])


def until(condition: Callable[[], T | None], *uplinks: Uplink) -> T:
    """Wait until `condition` returns something true, and return it. Meanwhile the uplinks are polled."""
    deadline_s = time.monotonic() + WAIT_S
    while not (result := condition()):
        for uplink in uplinks:
            uplink.poll()
        assert time.monotonic() < deadline_s
        time.sleep(0.002)
    return result
