"""What supervision promises, on processes that Ray started: whoever hangs or dies is replaced, and the run goes on."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import pytest

from actors.episode_counter import read_counts
from giirl_core.processes.supervision import CRASHES
from learner.checkpoint import latest_checkpoint
from learner.stream.snapshot import IngestSnapshot
from tests.end_to_end.cluster import ray_cluster
from tests.end_to_end.commands import Command, find, run_folder, step

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
    "actors.heartbeat_timeout_s=4.0",
    "scoring.replicas=2",
)
START_S = 200.0  # a busy machine needs long for Ray and torch
AWAKE = {"RAY_worker_niceness": "0"}  # nobody else's work may starve ours


def unaccounted(run: Path, tally: Path) -> int:
    """Of all that an actor finished, by its own count: what was neither trained on, nor kept, nor counted as dropped.

    Of incarnations that the books have settled it counts no more.
    """
    held = IngestSnapshot.load(latest_checkpoint(run / "checkpoints"))
    (mark,) = held.marks
    newest = dict(read_counts(tally))[mark.incarnation]
    assert held.counts["taken"] == 8 * step(run)
    return newest - mark.low_watermark - len(mark.acked)


def goes_on(command: Command, run: Path) -> None:
    reached = step(run)
    command.until(lambda: step(run) > reached + 2, "further iterations", timeout_s=START_S)


def test_a_run_whose_actor_dies_whenever_it_begins_gives_up_saves_and_says_so(full: bool) -> None:
    if not full:
        pytest.skip("takes minutes: `pytest tests/chaos` runs it")
    with run_folder() as run, Command(*WORDS, f"run={run}", env=AWAKE) as command:
        command.until(lambda: step(run) > 2, "first iterations", timeout_s=START_S)
        tally, begun = run / "actors" / "actor-0.tally", set[int]()

        def given_up() -> bool:
            incarnation, _ = read_counts(tally)[-1]
            if incarnation not in begun:
                begun.add(incarnation)
                for actor in find(command, "ray::ActorProcess"):
                    actor.kill()
            return "0 of 1 actors are left" in command.err

        command.until(given_up, "end of the run", timeout_s=START_S)
        assert command.wait() == 1
        error = r"giirl: 0 of 1 actors are left, wanted 1 \(actors\.min_healthy\): .+"
        assert re.search(error, command.err), command.err
        assert len(begun) == CRASHES
        assert command.remains() == []
        assert latest_checkpoint(run / "checkpoints").is_dir()


def test_an_actor_that_hangs_and_a_reward_service_that_dies_are_replaced_while_the_run_goes_on(full: bool) -> None:
    if not full:
        pytest.skip("takes minutes: `pytest tests/chaos` runs it")
    with run_folder() as run, Command(*WORDS, f"run={run}", env=AWAKE) as command:
        command.until(lambda: step(run) > 2, "first iterations", timeout_s=START_S)
        (hung,) = find(command, "ray::ActorProcess")
        hung.send_signal(signal.SIGSTOP)
        command.until(lambda: hung not in find(command, "ray::ActorProcess"), "end of the one that hangs", timeout_s=90)
        goes_on(command, run)
        first, second = find(command, "ray::RewardProcess")
        first.kill()
        goes_on(command, run)
        command.until(lambda: len(find(command, "ray::RewardProcess")) == 2, "another replica", timeout_s=90)
        assert second in find(command, "ray::RewardProcess")
        command.stop(signal.SIGINT)
        assert command.wait(timeout_s=90) == 130, command.err
        assert command.remains() == []
        assert unaccounted(run, run / "actors/actor-0.tally") == 0


def test_a_learner_that_died_on_a_cluster_comes_back_to_actors_and_replicas_that_waited(full: bool) -> None:
    if not full:
        pytest.skip("takes minutes: `pytest tests/chaos` runs it")
    with ray_cluster() as (head, _, reached), run_folder() as run:
        driver = {**reached, "TMPDIR": str(head.temporary)}
        words = [word.replace("runtime=local", "runtime=ray").replace("every=1000", "every=5") for word in WORDS]
        with Command(*words, f"run={run}", env=driver) as first:
            first.until(lambda: step(run) > 5, "first iterations", timeout_s=START_S)
            workers = {*find(head, "ray::ActorProcess"), *find(head, "ray::RewardProcess")}
            assert len(workers) == 3
            first.process.kill()
            first.process.wait()
        saved = latest_checkpoint(run / "checkpoints").name
        with Command("train", "--resume", str(run), env=driver) as second:
            second.until(lambda: latest_checkpoint(run / "checkpoints").name > saved, "a checkpoint", timeout_s=START_S)
            assert {*find(head, "ray::ActorProcess"), *find(head, "ray::RewardProcess")} == workers
            second.stop(signal.SIGTERM)
            assert second.wait(timeout_s=90) == 130, second.err
        identity = (run / "identity").read_text()
        assert unaccounted(run, head.temporary / "giirl" / identity / "actor-0.tally") == 0
