"""Rates of a training loop: what is counted, and over which time."""

from __future__ import annotations

import pytest

from giirl.throughput import MAX_TASKS, StreamState, Throughput, format_rates, format_success


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now_s = [0.0]
    monkeypatch.setattr("giirl.throughput.time.monotonic", lambda: now_s[0])
    return now_s


def test_rates_are_those_of_the_last_seconds_and_totals_those_of_the_session(clock: list[float]) -> None:
    throughput = Throughput()
    for step in range(100):
        with throughput.waiting():
            clock[0] += 0.3
        clock[0] += 0.7 if step < 50 else 0.2
        throughput.add([1, 3], 5, StreamState(stale=step // 10, actors_idle=0.25))
    recent = throughput.recent()
    assert recent["episodes_per_s"] == pytest.approx(4.0, abs=0.1)
    assert recent["env_steps_per_s"] == pytest.approx(10.0, abs=0.1)
    assert recent["learner_waits"] == pytest.approx(0.6, abs=0.01)
    assert (recent["lag"], recent["actors_idle"]) == (2.0, 0.25)
    assert recent["stale"] == pytest.approx(4 / 84, abs=0.01)
    total = throughput.total()
    assert total["episodes_per_s"] == pytest.approx(200 / 75, abs=0.1)
    assert total["learner_waits"] == pytest.approx(30 / 75, abs=0.01)
    assert total["stale"] == pytest.approx(9 / 209, abs=0.001)
    assert format_rates(recent, {"lost": 3}) == (
        "4 episodes/s, 10 steps/s, learner waits 60 %, actors idle 25 %, lag 2.0, stale 4.8 %, lost 3"
    )


def test_the_first_step_has_rates_too(clock: list[float]) -> None:
    throughput = Throughput()
    clock[0] += 2.0
    throughput.add([0] * 8, 8, StreamState())
    assert throughput.recent()["episodes_per_s"] == 4.0


def test_of_many_tasks_the_mean_and_the_lowest_are_shown() -> None:
    few = {"a": 0.5, "b": 0.25}
    assert format_success(few) == "a 50 %, b 25 %"
    many = {f"task-{i}": i / 10 for i in range(MAX_TASKS + 2)}
    assert format_success(many).startswith("45.0 % over 10 tasks, lowest task-0 0 %, task-1 10 %, ")
    assert "task-8" not in format_success(many)
