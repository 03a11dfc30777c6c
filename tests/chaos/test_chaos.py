"""Guarantees about delivery, memory and resuming, tested on real processes that are killed, suspended and cut off.

`make test` runs a short form; `pytest tests/chaos` runs all of it.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.chaos.abort import FAULTS
from tests.chaos.namespaces import missing
from tests.chaos.scripts import run_script

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1500)]


def settings(**values: Any) -> str:
    return json.dumps(values)


def test_through_all_faults_each_finished_episode_is_trained_on_once_or_counted_as_dropped(
    full: bool, tmp_path: Path
) -> None:
    short = {"crowds": 4, "actors_per_crowd": 5, "batch": 32, "faults": 15, "episodes": 2_000}
    long = {"crowds": 6, "actors_per_crowd": 170, "batch": 512, "faults": 205, "episodes": 105_000}
    arguments = settings(**(long if full else short), seed=7, deadline_s=1300 if full else 150)
    ledger = run_script("storm", tmp_path, arguments, timeout_s=1450 if full else 280, result="ledger.json")
    assert ledger["unaccounted"] == 0, ledger
    assert ledger["trained_twice"] == ledger["never_finished"] == 0, ledger
    assert ledger["trained"] == ledger["counted_as_taken"] > 0
    assert ledger["finished"] >= (100_000 if full else 2_000)
    assert sum(ledger["faults"].values()) >= (200 if full else 15)
    assert ledger["relay_faults"]
    if full:
        assert len(ledger["faults"]) == 11  # every kind
        assert len(ledger["relay_faults"]) == 9


@pytest.mark.parametrize("mode", ["serial", "lock-step"])
def test_a_run_that_is_killed_and_resumed_ends_with_the_same_parameters_to_the_bit(
    mode: str, full: bool, tmp_path: Path
) -> None:
    points = 20 if full else 2
    result = run_script("kill_points", tmp_path, mode, str(points), timeout_s=900, result="result.json")
    assert len(result["resumed"]) == points
    assert set(result["resumed"].values()) == {result["straight"]}, result


def test_memory_stays_constant_while_the_learner_is_stopped_and_all_actors_resume_after(
    full: bool, tmp_path: Path
) -> None:
    short = settings(actors=60, crowds=2, size=20_000, stop_s=3)
    long = settings(actors=1000, crowds=4, size=20_000, stop_s=60)
    result = run_script("flood", tmp_path, long if full else short, timeout_s=600, result="flood.json")
    for way in ("process", "updates"):
        memory = result[way]
        assert memory["learner_late_mib"] < 1.1 * memory["learner_mib"], result
        assert memory["actors_late_mib"] < 1.1 * memory["actors_mib"], result
        assert memory["resumed"] == (1000 if full else 60)
    assert result["ledger"]["unaccounted"] == 0


def test_no_episode_is_lost_when_the_network_is_cut_and_restored(full: bool, tmp_path: Path) -> None:
    if reason := missing():
        pytest.skip(reason)
    cut_s = 30.0 if full else 4.0  # after 15 s without an acknowledgement the sockets drop the connection
    result = run_script("cut", tmp_path, str(cut_s), timeout_s=150, result="cut.json")
    assert result["steps_while_cut"] == 0, result
    assert result["ledger"]["unaccounted"] == result["ledger"]["trained_twice"] == 0, result
    assert result["ledger"]["dropped"]["lost"] == 0, result


def test_corrupt_messages_and_files_raise_only_the_documented_errors(full: bool, tmp_path: Path) -> None:
    messages, files = (1_000_000, 10_000) if full else (10_000, 200)
    result = run_script("fuzz", tmp_path, str(messages), str(files), timeout_s=1100, result="fuzz.json")
    assert set(result["messages"]) == {"read", "WireError"}, result
    assert set(result["files"]) == {"read", "ValueError"}, result
    assert sum(result["messages"].values()) == messages
    assert sum(result["files"].values()) == files
    assert result["growth_mib"] < 16, result


def test_no_peer_makes_libzmq_abort_a_process(full: bool, tmp_path: Path) -> None:
    tries = 200 if full else 20
    result = run_script("abort", tmp_path, str(tries), timeout_s=900, result="abort.json")
    assert result == {fault: {"0": tries} for fault in FAULTS}


@pytest.mark.parametrize(
    ("setting", "faults"),
    [
        ("limit", ["pings_in_a_full_connection", "pings_in_a_full_dealer"]),
        ("heartbeats", ["reset_after_the_identity_was_taken", "reset_while_the_router_closes"]),
    ],
)
def test_a_receive_limit_or_heartbeats_would_make_libzmq_abort(setting: str, faults: list[str], tmp_path: Path) -> None:
    """If this fails, libzmq may have been repaired: then the sockets could have both again."""
    result = run_script("abort", tmp_path, "2", setting, timeout_s=120, result="abort.json")
    for fault in faults:
        assert result[fault].get("SIGABRT"), result
