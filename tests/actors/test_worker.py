"""The worker without browser and sockets: which weights it rejects, and what it delivers when it ends."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from actors.agents import PolicyAgent
from actors.uplink import Refused
from actors.worker import Worker, WorkerLimits
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import serialise_net
from giirl_core.types import UNSCORED, Episode, Trajectory
from giirl_core.weights import Weights
from tests.giirl_core.wire_examples import episode
from tests.learner.samples import policy, vectors


class SilentScorer:
    """A score client whose requests are never answered."""

    answering = True

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
        return 8 - unfinished

    def flush(self, timeout_s: float) -> None:
        self.flushed = True


def make_worker(scorer: SilentScorer | None, uplink: RecordingUplink, schedule: Any, metrics: Metrics) -> Worker:
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
    return serialise_net(policy(), version)


class FailingScorer(SilentScorer):
    """A score client whose requests fail while `down`, and otherwise get rewards of 7 from reward version 2."""

    def __init__(self) -> None:
        super().__init__()
        self.down = True
        self.requests = 0

    def submit(self, key: object, trajectory: Trajectory) -> None:
        self.requests += 1
        self._pending.append((key, trajectory))

    def poll(self) -> list[Any]:
        pending, self._pending = self._pending, []
        rewards = [None if self.down else np.full(t.reward_count, 7.0, np.float32) for _, t in pending]
        return [(key, scored, 2) for (key, _), scored in zip(pending, rewards, strict=True)]


def test_while_no_reward_service_answers_episodes_are_sent_unscored_at_once() -> None:
    scorer, uplink = FailingScorer(), RecordingUplink()
    worker = make_worker(scorer, uplink, None, Metrics())
    worker._finish(episode(1))  # sent before it is known
    scorer.answering = False
    for _ in range(19):
        worker._finish(episode(1))
    worker._poll()
    assert scorer.requests == 1
    assert [e.trajectory.reward_version for e in uplink.submitted] == [UNSCORED] * 20
    scorer.down, scorer.answering = False, True
    for _ in range(3):
        worker._finish(episode(1))
        worker._poll()
    assert scorer.requests == 4
    assert [e.trajectory.reward_version for e in uplink.submitted[20:]] == [2] * 3
    assert uplink.submitted[-1].trajectory.rewards.tolist() == [7.0]


def test_an_algorithm_without_a_learned_reward_requests_no_rewards() -> None:
    uplink, metrics = RecordingUplink(), Metrics()
    worker = make_worker(None, uplink, None, metrics)
    worker._finish(episode(1))
    worker._poll()
    assert len(uplink.submitted) == 1
    assert metrics.registry.get_sample_value("giirl_episodes_unscored_total") == 0


def test_no_episode_starts_beyond_the_credits_or_while_too_many_are_being_scored() -> None:
    worker = make_worker(SilentScorer(*[episode(1)] * 3), RecordingUplink(), None, Metrics())
    assert worker._startable(2) == 8 - 2 - 3
    worker._limits = replace(worker._limits, max_playing=4)
    assert worker._startable(2) == 2
    worker = make_worker(SilentScorer(*[episode(1)] * 65), RecordingUplink(), None, Metrics())
    assert worker._startable(0) == 0
