"""A worker process ends itself when it hears nothing of a learner, whatever it does at that time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread

import pytest

from actors.process import ActorProcess
from giirl_core.config_file import dump_config
from giirl_core.nets.parameters import serialise_net
from giirl_core.nets.reward import build_policy, build_reward
from giirl_core.processes import worker_process
from giirl_core.weights import Weights
from reward_service.process import RewardProcess
from tests.giirl.small import config

WAIT_S = 20.0
SHORT_S = 10.0  # the smallest value of the setting


class Clock:
    """The clock of the silence; everything else uses the real one."""

    def __init__(self) -> None:
        self.ahead_s = 0.0

    def monotonic(self) -> float:
        return time.monotonic() + self.ahead_s

    def sleep(self, seconds: float) -> None:
        time.sleep(min(seconds, 0.02))


class LeavingActor(ActorProcess):
    def __init__(self, *values: object) -> None:
        self.left = Event()
        super().__init__(*values)  # type: ignore[arg-type]

    def leave(self) -> None:
        self.left.set()


class LeavingService(RewardProcess):
    def __init__(self, config: str) -> None:
        self.left = Event()
        super().__init__(config, "run", "reward-service-0", encrypted=False)

    def leave(self) -> None:
        self.left.set()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    fake = Clock()
    monkeypatch.setattr(worker_process, "time", fake)
    return fake


def settings(path: Path) -> str:
    return dump_config(config(path, f"actors.orphan_timeout_s={SHORT_S}"))


def policy(path: Path) -> Weights:
    return serialise_net(build_policy(config(path)), 0)


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_a_process_that_no_learner_ever_calls_leaves(clock: Clock, tmp_path: Path) -> None:
    actor = LeavingActor(settings(tmp_path), "run", 0, tmp_path, False)
    clock.ahead_s += SHORT_S - 2
    assert not actor.left.wait(0.2)
    clock.ahead_s += 3
    assert actor.left.wait(WAIT_S)


def test_each_call_of_the_learner_is_a_sign_of_life(clock: Clock, tmp_path: Path) -> None:
    actor = LeavingActor(settings(tmp_path), "run", 0, tmp_path, False)
    weights = policy(tmp_path)
    calls = (
        actor.ping,
        lambda: actor.load(weights),
        lambda: actor.set_scorers(()),
        actor.forget,
        lambda: actor.stop(0),
    )
    for call in calls:
        clock.ahead_s += SHORT_S - 3
        call()
        assert actor.silent_s() < 1
        assert not actor.left.wait(0.1)


def test_a_reward_service_that_serves_leaves_when_its_learner_is_silent(clock: Clock, tmp_path: Path) -> None:
    service = LeavingService(settings(tmp_path))
    service.addresses()
    serving = Thread(target=service.run, args=(serialise_net(build_reward(config(tmp_path)).net, 0), ()))
    serving.start()
    until(lambda: service._running)
    clock.ahead_s += SHORT_S + 1
    assert service.left.wait(WAIT_S)
    service.stop()
    serving.join(WAIT_S)
    service._metrics.close()


def test_an_actor_that_waits_for_credits_of_a_dead_learner_leaves(
    clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("actors.uplink.time", clock)
    actor = LeavingActor(settings(tmp_path), "run", 0, tmp_path, False)
    nobody = "127.0.0.1:9"
    playing = Thread(target=actor.run, args=(1, 0, nobody, (), policy(tmp_path)))
    playing.start()
    until(lambda: actor._worker is not None)
    clock.ahead_s += SHORT_S + 1
    assert actor.left.wait(WAIT_S)
    actor.stop(0.0)
    playing.join(WAIT_S)


def test_a_process_that_was_stopped_leaves_soon_if_the_learner_does_not_end_it(clock: Clock, tmp_path: Path) -> None:
    long = replace(config(tmp_path), actors=replace(config(tmp_path).actors, orphan_timeout_s=3600.0))
    actor = LeavingActor(dump_config(long), "run", 0, tmp_path, False)
    actor.stop(0.0)
    clock.ahead_s += worker_process.STOPPED_TIMEOUT_S - 2
    assert not actor.left.wait(0.2)
    clock.ahead_s += 3
    assert actor.left.wait(WAIT_S)
