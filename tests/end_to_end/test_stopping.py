"""A run that is stopped in every way there is, goes on each time, and leaves no process behind."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.end_to_end.commands import Command, read_json, run_folder, step

pytestmark = [pytest.mark.chrome, pytest.mark.ray, pytest.mark.timeout(400)]

RAY_NOTICES_S = 90.0  # its agents look for their node for a minute before they give up
WORDS = (
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
    """One way of stopping, and what came of it."""

    status: int = 0
    err: str = ""
    left: list[str] = field(default_factory=list)
    begun: int = 0  # the first step that this part of the run did
    reached: int = 0  # iterations in the curve when it had ended
    saved: str = ""  # the newest checkpoint


@dataclass(slots=True, kw_only=True)
class Stops:
    """A run in three parts."""

    run: Path
    interrupted: Stop = field(default_factory=Stop)
    killed: Stop = field(default_factory=Stop)
    finished: Stop = field(default_factory=Stop)


@pytest.fixture(scope="module")
def stops() -> Iterator[Stops]:
    resume = ("train", "--resume")
    with run_folder() as run:
        seen = Stops(run=run)
        _part(run, seen.interrupted, (*WORDS, f"run={run}"), signal.SIGINT)
        with Command(*resume, run) as killed:  # what is left of it may go while the run is resumed already
            _stop(run, seen.killed, killed, signal.SIGKILL)
            _part(run, seen.finished, (*resume, str(run)), None)
            seen.killed.left = killed.remains(timeout_s=RAY_NOTICES_S)
        yield seen


def _part(run: Path, seen: Stop, words: tuple[str, ...], number: signal.Signals | None) -> None:
    with Command(*words) as command:
        _stop(run, seen, command, number)
        seen.left = command.remains()


def _stop(run: Path, seen: Stop, command: Command, number: signal.Signals | None) -> None:
    """Let it learn a little, then stop it; without a signal it ends by itself."""
    before = step(run)

    def learns() -> bool:
        seen.begun = seen.begun or (step(run) if step(run) != before else 0)
        return step(run) > max(before, 4)  # past the first checkpoint, also where the curve was cut

    command.until(learns, "progress")
    if number is not None:
        command.stop(number)
    seen.status = command.wait()
    seen.err, seen.reached = command.err, step(run)
    seen.saved = (run / "checkpoints" / "latest").read_text()


def test_ctrl_c_saves_a_run_and_says_how_to_go_on(stops: Stops) -> None:
    stop = stops.interrupted
    assert stop.status == 130, stop.err
    assert stop.saved.removesuffix("-again") == f"step-{stop.reached:08d}"
    assert stop.err.splitlines()[-1] == f"stopped and saved; to resume: giirl train --resume {stops.run}"
    assert "Traceback" not in stop.err


@pytest.mark.parametrize("way", ["interrupted", "killed", "finished"])
def test_no_process_outlives_a_run_however_it_ended(stops: Stops, way: str) -> None:
    stop: Stop = getattr(stops, way)
    assert stop.left == []


def test_a_resumed_run_goes_on_from_where_it_stopped(stops: Stops) -> None:
    assert f"resuming {stops.run} from {stops.interrupted.saved}" in stops.killed.err
    steps = [json.loads(line)["step"] for line in (stops.run / "curve.jsonl").read_text().splitlines()]
    assert steps == list(range(1, 41))


def test_a_killed_run_goes_on_from_its_last_checkpoint_to_the_end(stops: Stops) -> None:
    assert stops.killed.status == -signal.SIGKILL
    assert f"resuming {stops.run} from {stops.killed.saved}" in stops.finished.err
    assert stops.finished.status == 0, stops.finished.err
    assert read_json(stops.run / "result.json")["tasks"]["click-test-2"]["episodes"] == 10


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["Ctrl-C", "SIGTERM"])
def test_stopping_while_demonstrations_are_made_leaves_nothing(number: signal.Signals, tmp_path: Path) -> None:
    words = ("train", "runtime=serial", f"run={tmp_path / 'run'}", "demos.per_task=100000")
    with Command(*words) as command:
        command.until(lambda: "making demonstrations" in command.err, "demonstrations")
        command.until(lambda: len(command.look()) > 5, "Chrome")
        command.stop(number)
        assert command.wait() == 130
        assert command.remains() == []
        assert command.err.splitlines()[-1] == "giirl: interrupted"
