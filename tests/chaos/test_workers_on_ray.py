"""What supervision promises, on processes that Ray started: whoever hangs or dies is replaced, and the run goes on."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import psutil
import pytest

from learner.checkpoint import latest_checkpoint
from learner.held import Held
from tests.end_to_end.commands import Command, alive, command_line, run_folder, step

pytestmark = [pytest.mark.ray, pytest.mark.slow, pytest.mark.timeout(600)]

WORDS = (
    "train",
    "runtime=local",
    "browser=fake",
    f"tasks={json.dumps(['click-test-2'])}",
    "iterations=100000",
    "rollout_batch=8",
    "checkpoint_every=1000",
    "net.vectors=hashed",
    "net.width=16",
    "demos.per_task=4",
    "actors.silence_s=4.0",
    "scoring.replicas=2",
)
START_S = 200.0  # a busy machine needs long for Ray and torch
AWAKE = {"RAY_worker_niceness": "0"}  # nobody else's work may starve ours


def find(command: Command, title: str) -> list[psutil.Process]:
    """The processes to which Ray gave this class's name, alive and not on their way out."""
    return [p for p in command.look() if alive(p) and " ".join(command_line(p)[:1]).startswith(title)]


def goes_on(command: Command, run: Path) -> None:
    reached = step(run)
    command.until(lambda: step(run) > reached + 2, "further iterations", timeout_s=START_S)


def test_an_actor_that_hangs_and_a_reward_service_that_dies_are_replaced_while_the_run_goes_on(full: bool) -> None:
    if not full:
        pytest.skip("takes minutes: `pytest tests/chaos` runs it")
    with run_folder() as run, Command(*WORDS, f"run={run}", env=AWAKE) as command:
        command.until(lambda: step(run) > 2, "first iterations", timeout_s=START_S)
        (hung,) = find(command, "ray::ActorOnRay")
        hung.send_signal(signal.SIGSTOP)
        command.until(lambda: hung not in find(command, "ray::ActorOnRay"), "end of the one that hangs", timeout_s=90)
        goes_on(command, run)
        first, second = find(command, "ray::RewardOnRay")
        first.kill()
        goes_on(command, run)
        command.until(lambda: len(find(command, "ray::RewardOnRay")) == 2, "another replica", timeout_s=90)
        assert second in find(command, "ray::RewardOnRay")
        command.stop(signal.SIGINT)
        assert command.wait(timeout_s=90) == 130, command.err
        assert command.remains() == []
        held = Held.load(latest_checkpoint(run / "checkpoints"))
        (mark,) = held.marks
        assert mark.actor == "actor-0"
        assert held.counts["taken"] >= 8 * step(run)
