"""An actor's thread without browser and sockets: what it refuses, and that it leaves nothing behind."""

from __future__ import annotations

from typing import Any

import pytest

from actors.agents import PolicyAgent
from actors.uplink import Refused
from actors.worker import Worker, WorkerLimits
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import seal_net
from giirl_core.types import Episode, Weights
from tests.giirl_core.wire_examples import episode
from tests.learner.samples import policy, vectors


class Scorer:
    """A reward service that does not answer."""

    def __init__(self, *pending: Episode) -> None:
        self._pending: list[Any] = list(pending)

    @property
    def pending(self) -> int:
        return len(self._pending)

    def poll(self) -> list[Any]:
        return []

    def cancel_pending(self) -> list[Any]:
        given, self._pending = self._pending, []
        return given


class Uplink:
    """Takes everything."""

    ready, silent_for_s = True, 0.0

    def __init__(self) -> None:
        self.offered: list[Episode] = []
        self.flushed = False

    def offer(self, finished: Episode) -> None:
        self.offered.append(finished)

    def poll(self) -> None: ...

    def flush(self, timeout_s: float) -> None:
        self.flushed = True


def worker(scorer: Scorer, uplink: Uplink, schedule: Any, metrics: Metrics) -> Worker:
    browser: Any = None
    stand_ins: Any = (scorer, uplink)
    limits = WorkerLimits(step_limit=3, flush_s=0.05)
    return Worker(browser, PolicyAgent(policy(), vectors()), schedule, *stand_ins, limits=limits, metrics=metrics)


def nothing_to_play(trouble: Exception) -> Any:
    def schedule(version: int) -> Any:
        raise trouble

    return schedule


def test_what_nobody_scored_is_handed_over_unscored_when_an_actor_ends() -> None:
    finished, uplink, metrics = episode(1), Uplink(), Metrics()
    made = worker(Scorer(finished), uplink, nothing_to_play(OSError("no browser")), metrics)
    with pytest.raises(OSError, match="no browser"):
        made.run()
    assert uplink.offered == [finished]
    assert uplink.flushed
    assert metrics.registry.get_sample_value("giirl_episodes_unscored_total") == 1


def test_an_actor_that_is_refused_hands_nothing_over() -> None:
    uplink = Uplink()
    with pytest.raises(Refused):
        worker(Scorer(episode(1)), uplink, nothing_to_play(Refused("fenced")), Metrics()).run()
    assert uplink.offered == []


def test_weights_that_are_damaged_or_older_are_refused_and_counted() -> None:
    metrics = Metrics()
    made = worker(Scorer(), Uplink(), None, metrics)
    for version in (3, 5):
        made.load(sealed(version))
    made.load(sealed(4))
    made.load(Weights(version=6, digest="none", blob=sealed(6).blob))
    made._obey()
    assert metrics.registry.get_sample_value("giirl_policy_version") == 5
    assert metrics.registry.get_sample_value("giirl_weights_refused_total", {"network": "policy"}) == 2


def sealed(version: int) -> Weights:
    return seal_net(policy(), version)
