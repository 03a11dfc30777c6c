"""Restart, backoff, replacement and quarantine of supervised processes, with fake processes and a fake clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from giirl_core.metrics import Metrics
from giirl_core.processes.supervision import (
    BACKOFF_MAX_S,
    MAX_CRASHES,
    START_TIMEOUT_S,
    Call,
    Process,
    ProcessDied,
    SupervisedProcess,
    backoff_s,
)


class FakeClock:
    """A clock that only the test advances."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


class FakeCall:
    """A call that stays pending until the test completes it."""

    def __init__(self, value: Any = None, *, error: str = "", pending: bool = False) -> None:
        self.value, self.error, self.pending = value, error, pending

    def done(self) -> bool:
        return not self.pending

    def result(self, timeout_s: float) -> Any:
        if self.error:
            raise ProcessDied(self.error)
        return self.value


class FakeProcess:
    """A process that records its calls and kills."""

    reattached = False

    def __init__(self) -> None:
        self.calls: list[tuple[str, tuple[Any, ...]]] = []
        self.kills = 0
        self.has_place = True
        self.results: dict[str, Callable[[], FakeCall]] = {"addresses": lambda: FakeCall(("m:1", "s:1"))}

    def call(self, method: str, *values: Any) -> FakeCall:
        self.calls.append((method, values))
        return self.results.get(method, FakeCall)()

    def placed(self) -> bool:
        return self.has_place

    def kill(self) -> None:
        self.kills += 1


class Harness:
    """A supervised process on top of a fake one."""

    def __init__(self) -> None:
        self.process, self.metrics = FakeProcess(), Metrics()
        self.run = FakeCall(pending=True)
        self.starts = 0  # of processes; one fake stands for all of them
        self.runs: list[int] = []  # for every run, the number of the process
        self.supervised = self.supervise()

    def supervise(self, **limits: float) -> SupervisedProcess:
        self.starts = 0
        return SupervisedProcess("actor-3", self.start, self.start_run, self.metrics, **limits)

    def start(self) -> Process:
        self.starts += 1
        return self.process

    def start_run(self, process: Process, addresses: tuple[str, str]) -> Call:
        self.runs.append(self.starts)
        self.run = FakeCall(pending=True)
        return self.run

    def exit(self, error: str) -> None:
        self.run.error, self.run.pending = error, False


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    fake = FakeClock()
    monkeypatch.setattr("giirl_core.processes.supervision.time", fake)
    return fake


@pytest.fixture
def harness(clock: FakeClock) -> Harness:
    return Harness()


def start(harness: Harness, clock: FakeClock) -> None:
    for _ in range(3):
        clock.now_s += BACKOFF_MAX_S
        harness.supervised.poll()


def after(seconds: float, supervised: SupervisedProcess, clock: FakeClock) -> str:
    """The state that a process has after this time."""
    clock.now_s += seconds
    supervised.poll()
    return supervised.state


def test_the_run_starts_once_the_process_has_reported_its_addresses(harness: Harness, clock: FakeClock) -> None:
    assert harness.runs == []
    start(harness, clock)
    assert harness.runs == [1]
    assert harness.supervised.addresses == ("m:1", "s:1")
    assert harness.supervised.healthy


def test_a_process_that_exited_is_restarted_after_a_backoff(harness: Harness, clock: FakeClock) -> None:
    start(harness, clock)
    harness.exit("out of memory")
    harness.supervised.poll()
    harness.supervised.poll()  # started again; the run waits for the backoff
    assert harness.runs == [1]
    clock.now_s += 1.0
    harness.supervised.poll()
    assert harness.runs == [1, 2]
    assert harness.supervised.last_error == "out of memory"
    assert harness.metrics.registry.get_sample_value("giirl_worker_exits_total", {"kind": "actor"}) == 1


def test_the_backoff_grows_up_to_a_maximum_and_has_jitter() -> None:
    backoffs = [[backoff_s(crashes) for _ in range(50)] for crashes in range(1, 12)]
    assert max(backoffs[0]) < min(backoffs[3])
    assert max(map(max, backoffs)) <= BACKOFF_MAX_S
    assert all(len(set(repeated)) > 40 for repeated in backoffs)


def test_a_process_in_a_crash_loop_is_quarantined_with_the_reason(harness: Harness, clock: FakeClock) -> None:
    for _ in range(MAX_CRASHES):
        assert harness.supervised.healthy
        start(harness, clock)
        harness.exit("no such browser")
        harness.supervised.poll()
    assert harness.supervised.quarantine_reason == f"no such browser, {MAX_CRASHES} times in a row"
    assert not harness.supervised.healthy
    start(harness, clock)
    assert len(harness.runs) == MAX_CRASHES


def test_exits_after_stable_runs_are_not_a_crash_loop(harness: Harness, clock: FakeClock) -> None:
    for _ in range(3 * MAX_CRASHES):
        start(harness, clock)
        clock.now_s += 100.0
        harness.exit("out of memory")
        harness.supervised.poll()
    assert not harness.supervised.quarantined


def test_a_hung_process_is_killed_and_its_replacement_runs(harness: Harness, clock: FakeClock) -> None:
    start(harness, clock)
    harness.supervised.replace(60.0, heartbeat_received=True)
    assert harness.process.kills == 1
    start(harness, clock)
    assert harness.runs == [1, 2]


def test_a_process_that_does_not_start_in_time_is_killed(harness: Harness, clock: FakeClock) -> None:
    harness.process.results["addresses"] = lambda: FakeCall(pending=True)
    supervised = harness.supervise()
    supervised.poll()
    clock.now_s += START_TIMEOUT_S - 1
    supervised.poll()
    assert harness.process.kills == 0
    clock.now_s += 2
    supervised.poll()
    assert harness.process.kills == 1
    assert "did not start" in supervised.last_error


def test_a_process_that_repeatedly_fails_to_start_is_quarantined(harness: Harness, clock: FakeClock) -> None:
    for addresses in (FakeCall(pending=True), FakeCall(error="no such image")):
        harness.process.results["addresses"] = lambda addresses=addresses: addresses  # type: ignore[misc]
        supervised = harness.supervise()
        for _ in range(MAX_CRASHES):
            assert supervised.healthy
            for seconds in (BACKOFF_MAX_S, START_TIMEOUT_S + 1) if addresses.pending else (BACKOFF_MAX_S,):
                clock.now_s += seconds
                supervised.poll()
        assert not supervised.healthy
        assert "did not start" in supervised.quarantine_reason
    assert "no such image" in supervised.quarantine_reason


def test_a_process_that_runs_long_without_a_heartbeat_is_quarantined_eventually(
    harness: Harness, clock: FakeClock
) -> None:
    for _ in range(MAX_CRASHES):
        assert harness.supervised.healthy
        start(harness, clock)
        clock.now_s += 180.0
        harness.supervised.replace(180.0, heartbeat_received=False)
    assert not harness.supervised.healthy


def test_the_time_that_a_load_has_been_pending_is_known(harness: Harness, clock: FakeClock) -> None:
    loading = FakeCall(pending=True)
    harness.process.results["load"] = lambda: loading
    start(harness, clock)
    harness.supervised.load("w1")
    clock.now_s += 70.0
    assert harness.supervised.load_pending_s == 70.0
    loading.pending = False
    assert harness.supervised.load_pending_s == 0.0


def test_a_process_that_fails_to_start_is_replaced_by_another_one(harness: Harness, clock: FakeClock) -> None:
    failures = [FakeCall(error="no such image"), FakeCall(error="no such image")]
    harness.process.results["addresses"] = lambda: failures.pop() if failures else FakeCall(("m:2", ""))
    harness.supervised = harness.supervise()
    start(harness, clock)
    start(harness, clock)
    assert harness.supervised.addresses == ("m:2", "")
    assert harness.starts == 3


def test_waiting_for_a_place_is_no_crash_however_long_it_lasts(harness: Harness, clock: FakeClock) -> None:
    addresses = FakeCall(("m:1", ""), pending=True)
    harness.process.results["addresses"] = lambda: addresses
    harness.process.has_place = False
    supervised = harness.supervise()
    assert {after(START_TIMEOUT_S, supervised, clock) for _ in range(100)} == {"waiting"}
    assert (harness.process.kills, harness.starts) == (0, 1)
    harness.process.has_place = True
    assert after(0, supervised, clock) == "starting"
    addresses.pending = False
    assert after(START_TIMEOUT_S - 1, supervised, clock) == "running"
    assert harness.metrics.registry.get_sample_value("giirl_worker_exits_total", {"kind": "actor"}) == 0


def test_a_process_without_a_place_is_given_up_at_the_deadline(harness: Harness, clock: FakeClock) -> None:
    harness.process.results["addresses"] = lambda: FakeCall(pending=True)
    harness.process.has_place = False
    supervised = harness.supervise(place_timeout_s=3600.0)
    assert after(3599.0, supervised, clock) == "waiting"
    assert after(2.0, supervised, clock) == "given_up"
    assert supervised.quarantine_reason == "no node had a place for it within 3600 s"
    assert harness.process.kills == 1


def test_weights_sent_faster_than_they_are_loaded_are_skipped_except_the_newest(
    harness: Harness, clock: FakeClock
) -> None:
    loading = FakeCall(pending=True)
    harness.process.results["load"] = lambda: loading
    harness.supervised.load("w0")
    assert "load" not in dict(harness.process.calls)  # the run has not started
    start(harness, clock)
    for weights in ("w1", "w2", "w3"):
        harness.supervised.load(weights)
    loading.pending = False
    harness.supervised.poll()
    assert [values for method, values in harness.process.calls if method == "load"][-1] == ("w3",)
    assert len([method for method, _ in harness.process.calls if method == "load"]) == 2


def test_a_process_that_was_asked_to_stop_is_not_restarted(harness: Harness, clock: FakeClock) -> None:
    start(harness, clock)
    harness.supervised.stopping = True
    harness.exit("")
    start(harness, clock)
    assert harness.runs == [1]
    assert not harness.supervised.healthy
