"""Who is begun again, who is replaced, who is given up: on processes that do as a test says."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from giirl_core.metrics import Metrics
from giirl_core.processes import supervision
from giirl_core.processes.supervision import CRASHES, PAUSE_MAX_S, Call, Gone, Process, SupervisedProcess, pause


class Clock:
    """Time that passes when a test says so."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


class Answer:
    """A call that ends when a test says so."""

    def __init__(self, value: Any = None, *, trouble: str = "", open_: bool = False) -> None:
        self.value, self.trouble, self.open = value, trouble, open_

    def done(self) -> bool:
        return not self.open

    def result(self, timeout_s: float) -> Any:
        if self.trouble:
            raise Gone(self.trouble)
        return self.value


class Puppet:
    """A process that notes what is asked of it."""

    reattached = False

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self.kills: list[bool] = []
        self.answers: dict[str, Callable[[], Answer]] = {"addresses": lambda: Answer(("m:1", "s:1"))}

    def call(self, method: str, *values: Any) -> Answer:
        self.calls.append((method, values))
        return self.answers.get(method, Answer)()

    def kill(self, *, restart: bool) -> None:
        self.kills.append(restart)


class Stage:
    """A member with its puppet."""

    def __init__(self) -> None:
        self.puppet, self.metrics = Puppet(), Metrics()
        self.run = Answer(open_=True)
        self.begun: list[int] = []
        self.member = SupervisedProcess("actor-3", self.puppet, self._begin, self.metrics)

    def _begin(self, process: Process, restarts: int) -> Call:
        self.begun.append(restarts)
        self.run = Answer(open_=True)
        return self.run

    def end(self, trouble: str) -> None:
        self.run.trouble, self.run.open = trouble, False


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr("giirl_core.processes.supervision.time", made)
    return made


@pytest.fixture
def stage(clock: Clock) -> Stage:
    return Stage()


def up(stage: Stage, clock: Clock) -> None:
    for _ in range(3):
        clock.now_s += PAUSE_MAX_S
        stage.member.poll()


def test_a_process_is_begun_once_it_has_started_and_its_addresses_are_known(stage: Stage, clock: Clock) -> None:
    assert stage.begun == []
    up(stage, clock)
    assert stage.begun == [0]
    assert stage.member.addresses == ("m:1", "s:1")
    assert stage.member.healthy


def test_a_process_that_ended_is_begun_again_after_a_pause(stage: Stage, clock: Clock) -> None:
    up(stage, clock)
    stage.end("it fell over")
    stage.member.poll()
    stage.member.poll()  # up again, but not yet begun
    assert stage.begun == [0]
    clock.now_s += 1.0
    stage.member.poll()
    assert stage.begun == [0, 1]
    assert stage.member.trouble == "it fell over"
    assert stage.metrics.registry.get_sample_value("giirl_worker_restarts_total", {"kind": "actor"}) == 1


def test_pauses_grow_have_an_end_and_are_never_the_same() -> None:
    drawn = [[pause(crashes) for _ in range(50)] for crashes in range(1, 12)]
    assert max(drawn[0]) < min(drawn[3])
    assert max(map(max, drawn)) <= PAUSE_MAX_S
    assert all(len(set(some)) > 40 for some in drawn)


def test_whoever_ends_at_once_again_and_again_is_given_up_with_the_reason(stage: Stage, clock: Clock) -> None:
    for _ in range(CRASHES):
        assert stage.member.healthy
        up(stage, clock)
        stage.end("no such browser")
        stage.member.poll()
    assert stage.member.quarantined == "no such browser"
    assert not stage.member.healthy
    up(stage, clock)
    assert len(stage.begun) == CRASHES


def test_ends_that_are_far_apart_are_no_crash_loop(stage: Stage, clock: Clock) -> None:
    for _ in range(3 * CRASHES):
        up(stage, clock)
        clock.now_s += 100.0
        stage.end("it fell over")
        stage.member.poll()
    assert not stage.member.quarantined


def test_a_process_that_hangs_is_killed_and_another_begun_in_its_place(stage: Stage, clock: Clock) -> None:
    up(stage, clock)
    stage.member.replace(60.0, heard=True)
    assert stage.puppet.kills == [True]
    up(stage, clock)
    assert stage.begun == [0, 1]


def test_a_process_that_never_starts_is_killed_in_the_end(stage: Stage, clock: Clock) -> None:
    stage.puppet.answers["addresses"] = lambda: Answer(open_=True)
    member = SupervisedProcess("actor-4", stage.puppet, stage._begin, stage.metrics)
    clock.now_s += supervision.START_S - 1
    member.poll()
    assert stage.puppet.kills == []
    clock.now_s += 2
    member.poll()
    assert stage.puppet.kills == [True]
    assert "did not start" in member.trouble


def test_one_that_never_starts_again_and_again_is_given_up(stage: Stage, clock: Clock) -> None:
    for answer in (Answer(open_=True), Answer(trouble="no such image")):
        stage.puppet.answers["addresses"] = lambda answer=answer: answer  # type: ignore[misc]
        member = SupervisedProcess("actor-4", stage.puppet, stage._begin, stage.metrics)
        for _ in range(CRASHES):
            assert member.healthy
            clock.now_s += supervision.START_S + 1
            member.poll()
        assert not member.healthy
        assert "did not start" in member.quarantined
    assert "no such image" in member.quarantined


def test_one_that_runs_for_long_and_is_never_heard_is_given_up_in_the_end(stage: Stage, clock: Clock) -> None:
    for _ in range(CRASHES):
        assert stage.member.healthy
        up(stage, clock)
        clock.now_s += 180.0
        stage.member.replace(180.0, heard=False)
    assert not stage.member.healthy


def test_how_long_weights_have_not_been_taken_is_known(stage: Stage, clock: Clock) -> None:
    loading = Answer(open_=True)
    stage.puppet.answers["load"] = lambda: loading
    up(stage, clock)
    stage.member.load("w1")
    clock.now_s += 70.0
    assert stage.member.stuck_s == 70.0
    loading.open = False
    assert stage.member.stuck_s == 0.0


def test_calls_that_a_platform_refuses_while_it_starts_a_process_are_repeated(stage: Stage, clock: Clock) -> None:
    refusals = [Answer(trouble="it restarts"), Answer(trouble="it restarts")]
    stage.puppet.answers["addresses"] = lambda: refusals.pop() if refusals else Answer(("m:2", ""))
    stage.member = SupervisedProcess("actor-3", stage.puppet, stage._begin, stage.metrics)
    up(stage, clock)
    up(stage, clock)
    assert stage.member.addresses == ("m:2", "")


def test_of_weights_that_come_faster_than_they_are_taken_the_newest_arrive(stage: Stage, clock: Clock) -> None:
    loading = Answer(open_=True)
    stage.puppet.answers["load"] = lambda: loading
    stage.member.load("w0")
    assert "load" not in dict(stage.puppet.calls)  # it has not begun
    up(stage, clock)
    for weights in ("w1", "w2", "w3"):
        stage.member.load(weights)
    loading.open = False
    stage.member.poll()
    assert [values for method, values in stage.puppet.calls if method == "load"][-1] == ("w3",)
    assert len([method for method, _ in stage.puppet.calls if method == "load"]) == 2


def test_one_that_was_asked_to_leave_is_not_begun_again(stage: Stage, clock: Clock) -> None:
    up(stage, clock)
    stage.member.leaving = True
    stage.end("")
    up(stage, clock)
    assert stage.begun == [0]
    assert not stage.member.healthy
