"""A run that is interrupted, killed and resumed: it goes on each time and leaves no process behind."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.end_to_end.commands import Command, read_json, run_folder, step

pytestmark = [pytest.mark.chrome, pytest.mark.ray, pytest.mark.timeout(400)]

RAY_CLEANUP_S = 90.0  # Ray agents search for their node for a minute before they exit
ARGUMENTS = (
    "train",
    "runtime=local",
    f"tasks={json.dumps(['click-test-2'])}",
    "iterations=40",
    "rollout_batch=8",
    "checkpoint_every=4",
    "net.vectors=hashed",
    "demos.per_task=8",
    "evaluate.episodes=10",
    "evaluate.random_episodes=10",
)


@dataclass(slots=True, kw_only=True)
class Stop:
    """One part of the run and how it ended."""

    status: int = 0
    err: str = ""
    leftover: list[str] = field(default_factory=list)  # processes that outlived it
    last_step: int = 0
    saved: str = ""  # the newest checkpoint


@dataclass(slots=True, kw_only=True)
class Stops:
    """A run in three parts, each resumed from the one before."""

    run: Path
    interrupted: Stop = field(default_factory=Stop)
    killed: Stop = field(default_factory=Stop)
    finished: Stop = field(default_factory=Stop)


@pytest.fixture(scope="module")
def stops() -> Iterator[Stops]:
    resume = ("train", "--resume")
    with run_folder() as run:
        result = Stops(run=run)
        _run_part(run, result.interrupted, (*ARGUMENTS, f"run={run}"), signal.SIGINT)
        with Command(*resume, run) as killed:  # its processes may still exit while the run is resumed
            _stop(run, result.killed, killed, signal.SIGKILL)
            _run_part(run, result.finished, (*resume, str(run)), None)
            result.killed.leftover = killed.wait_leftover(timeout_s=RAY_CLEANUP_S)
        yield result


def _run_part(run: Path, stop: Stop, arguments: tuple[str, ...], number: signal.Signals | None) -> None:
    with Command(*arguments) as command:
        _stop(run, stop, command, number)
        stop.leftover = command.wait_leftover()


def _stop(run: Path, stop: Stop, command: Command, number: signal.Signals | None) -> None:
    """Let the run train a few steps, then send the signal; without one, wait for its end."""
    before = step(run)
    # Wait until it is past the first checkpoint, also if resuming has shortened the curve.
    command.until(lambda: step(run) > max(before, 4), "progress")
    if number is not None:
        command.stop(number)
    stop.status = command.wait()
    stop.err, stop.last_step = command.err, step(run)
    stop.saved = (run / "checkpoints" / "latest").read_text()


def test_ctrl_c_saves_the_run_and_prints_how_to_resume_it(stops: Stops) -> None:
    stop = stops.interrupted
    assert stop.status == 130, stop.err
    assert stop.saved.removesuffix("-again") == f"step-{stop.last_step:08d}"
    assert stop.err.splitlines()[-1] == f"stopped and saved; to resume: giirl train --resume {stops.run}"
    assert "Traceback" not in stop.err


@pytest.mark.parametrize("way", ["interrupted", "killed", "finished"])
def test_no_process_outlives_a_run(stops: Stops, way: str) -> None:
    stop: Stop = getattr(stops, way)
    assert stop.leftover == []


def test_a_resumed_run_goes_on_from_where_it_stopped(stops: Stops) -> None:
    assert f"resuming {stops.run} from {stops.interrupted.saved}" in stops.killed.err
    steps = [json.loads(line)["step"] for line in (stops.run / "curve.jsonl").read_text().splitlines()]
    assert steps == list(range(1, 41))


def test_a_killed_run_can_be_resumed_from_its_last_checkpoint(stops: Stops) -> None:
    assert stops.killed.status == -signal.SIGKILL
    assert f"resuming {stops.run} from {stops.killed.saved}" in stops.finished.err
    assert stops.finished.status == 0, stops.finished.err
    assert read_json(stops.run / "result.json")["tasks"]["click-test-2"]["episodes"] == 10


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_stopping_while_demonstrations_are_made_leaves_no_process(number: signal.Signals, tmp_path: Path) -> None:
    arguments = ("train", "runtime=serial", f"run={tmp_path / 'run'}", "demos.per_task=100000")
    with Command(*arguments) as command:
        command.until(lambda: "making demonstrations" in command.err, "demonstrations")
        command.until(lambda: len(command.find_descendants()) > 5, "Chrome")
        command.stop(number)
        assert command.wait() == 130
        assert command.wait_leftover() == []
        assert command.err.splitlines()[-1] == "giirl: interrupted"
