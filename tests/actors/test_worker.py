"""The worker without browser and sockets: which weights it rejects, and what it delivers when it ends."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from actors.agents import PolicyAgent
from actors.uplink import Refused
from actors.worker import Worker, WorkerLimits
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import seal_net
from giirl_core.types import Episode
from giirl_core.weights import Weights
from tests.giirl_core.wire_examples import episode
from tests.learner.samples import policy, vectors


class SilentScorer:
    """A score client whose requests are never answered."""

    def __init__(self, *pending: Episode) -> None:
        self._pending: list[Any] = list(pending)

    @property
    def pending(self) -> int:
        return len(self._pending)

    def poll(self) -> list[Any]:
        return []

    def cancel_pending(self) -> list[Any]:
        pending, self._pending = self._pending, []
        return pending


class RecordingUplink:
    """Accepts every episode."""

    silent_for_s = 0.0

    def __init__(self) -> None:
        self.submitted: list[Episode] = []
        self.flushed = False

    def submit(self, finished: Episode) -> None:
        self.submitted.append(finished)

    def poll(self) -> None: ...

    def startable(self, unfinished: int) -> int:
        return 8

    def flush(self, timeout_s: float) -> None:
        self.flushed = True


def make_worker(scorer: SilentScorer, uplink: RecordingUplink, schedule: Any, metrics: Metrics) -> Worker:
    browser: Any = SimpleNamespace(tabs=1)
    fakes: Any = (scorer, uplink)
    limits = WorkerLimits(step_limit=3, flush_timeout_s=0.05)
    return Worker(browser, PolicyAgent(policy(), vectors()), schedule, *fakes, limits=limits, metrics=metrics)


def failing_schedule(error: Exception) -> Any:
    def schedule(version: int) -> Any:
        raise error

    return schedule


def test_episodes_without_rewards_are_delivered_unscored_when_an_actor_ends() -> None:
    finished, uplink, metrics = episode(1), RecordingUplink(), Metrics()
    worker = make_worker(SilentScorer(finished), uplink, failing_schedule(OSError("no browser")), metrics)
    with pytest.raises(OSError, match="no browser"):
        worker.run()
    assert uplink.submitted == [finished]
    assert uplink.flushed
    assert metrics.registry.get_sample_value("giirl_episodes_unscored_total") == 1


def test_a_refused_actor_delivers_nothing() -> None:
    uplink = RecordingUplink()
    with pytest.raises(Refused):
        make_worker(SilentScorer(episode(1)), uplink, failing_schedule(Refused("fenced")), Metrics()).run()
    assert uplink.submitted == []


def test_corrupt_and_older_weights_are_rejected_and_counted() -> None:
    metrics = Metrics()
    worker = make_worker(SilentScorer(), RecordingUplink(), None, metrics)
    for version in (3, 5):
        worker.load(sealed(version))
    worker.load(sealed(4))
    worker.load(Weights(version=6, digest="none", blob=sealed(6).blob))
    worker._run_calls()
    assert metrics.registry.get_sample_value("giirl_policy_version") == 5
    assert metrics.registry.get_sample_value("giirl_weights_refused_total", {"network": "policy"}) == 2


def sealed(version: int) -> Weights:
    return seal_net(policy(), version)
