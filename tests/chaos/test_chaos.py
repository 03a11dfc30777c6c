"""What is promised of delivery, memory and resuming, on real processes that are killed, stopped and cut off.

`make test` runs a short form; `pytest tests/chaos` all of it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.chaos.namespaces import missing
from tests.chaos.scripts import play

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]


def settings(**values: Any) -> str:
    return json.dumps(values)


def test_through_every_fault_each_finished_episode_is_trained_on_once_or_in_a_counted_drop(
    full: bool, tmp_path: Path
) -> None:
    short = {"crowds": 4, "players": 5, "batch": 32, "faults": 15, "episodes": 2_000}
    long = {"crowds": 6, "players": 170, "batch": 512, "faults": 205, "episodes": 105_000}
    words = settings(**(long if full else short), seed=7, deadline_s=1300 if full else 150)
    ledger = play("storm", tmp_path, words, timeout_s=1450 if full else 280, result="ledger.json")
    assert ledger["unaccounted"] == 0, ledger
    assert ledger["trained_twice"] == ledger["never_finished"] == 0, ledger
    assert ledger["trained"] == ledger["taken_by_the_books"] > 0
    assert ledger["finished"] >= (100_000 if full else 2_000)
    assert sum(ledger["faults"].values()) >= (200 if full else 15)
    assert max(ledger["learner_back_s"], default=0) < 10
    assert ledger["harms"]
    if full:
        assert len(ledger["faults"]) == 10  # of every kind
        assert len(ledger["harms"]) == 9


@pytest.mark.parametrize("mode", ["serial", "lock-step"])
def test_a_run_killed_anywhere_and_resumed_ends_in_the_bits_of_one_that_was_not(
    mode: str, full: bool, tmp_path: Path
) -> None:
    points = 20 if full else 2
    found = play("kill_points", tmp_path, mode, str(points), timeout_s=900, result="result.json")
    assert len(found["resumed"]) == points
    assert set(found["resumed"].values()) == {found["straight"]}, found


def test_memory_stays_flat_while_the_learner_is_stopped_and_everybody_goes_on_after(full: bool, tmp_path: Path) -> None:
    short = settings(actors=60, crowds=2, size=20_000, stop_s=3)
    long = settings(actors=1000, crowds=4, size=20_000, stop_s=60)
    found = play("flood", tmp_path, long if full else short, timeout_s=600, result="flood.json")
    for how in ("process", "updates"):
        seen = found[how]
        assert seen["learner_late_mib"] < 1.1 * seen["learner_mib"], found
        assert seen["actors_late_mib"] < 1.1 * seen["actors_mib"], found
        assert seen["resumed"] == (1000 if full else 60)
    assert found["ledger"]["unaccounted"] == 0


def test_a_network_that_was_cut_and_mended_costs_no_episode(full: bool, tmp_path: Path) -> None:
    if why := missing():
        pytest.skip(why)
    cut_s = 30.0 if full else 4.0  # beyond 15 s the sockets themselves give the other end up
    found = play("cut", tmp_path, str(cut_s), timeout_s=150, result="cut.json")
    assert found["steps_while_cut"] == 0, found
    assert found["ledger"]["unaccounted"] == found["ledger"]["trained_twice"] == 0, found
    assert found["ledger"]["dropped"]["lost"] == 0, found


def test_of_spoiled_messages_and_files_come_only_the_documented_errors(full: bool, tmp_path: Path) -> None:
    messages, files = (1_000_000, 10_000) if full else (10_000, 200)
    found = play("fuzz", tmp_path, str(messages), str(files), timeout_s=1100, result="fuzz.json")
    assert set(found["messages"]) == {"read", "WireError"}, found
    assert set(found["files"]) == {"read", "ValueError"}, found
    assert sum(found["messages"].values()) == messages
    assert sum(found["files"].values()) == files
    assert found["growth_mib"] < 16, found
