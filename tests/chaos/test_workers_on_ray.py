"""Supervision of real Ray processes: a process that hangs or dies is replaced, and the run goes on."""

from __future__ import annotations

import json
import re
import signal
from pathlib import Path

import pytest

from actors.episode_counter import read_counts
from giirl_core.processes.supervision import MAX_CRASHES
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
RAY_CLEANUP_S = 90.0  # Ray agents search for their node for a minute before they exit
START_S = 200.0  # Ray and torch take long to start on a busy machine
ENV = {"RAY_worker_niceness": "0"}  # other programs must not starve the workers


def unaccounted(run: Path, counter_file: Path) -> int:
    """Episodes of an actor's newest incarnation that are neither trained on, queued, nor counted as dropped."""
    snapshot = IngestSnapshot.load(latest_checkpoint(run / "checkpoints"))
    (offsets,) = snapshot.offsets
    finished = dict(read_counts(counter_file))[offsets.incarnation]
    assert snapshot.counts["taken"] == 8 * step(run)
    return finished - offsets.low_watermark - len(offsets.acked)


def assert_goes_on(command: Command, run: Path) -> None:
    reached = step(run)
    command.until(lambda: step(run) > reached + 2, "further iterations", timeout_s=START_S)


def test_a_run_whose_actor_dies_at_every_start_is_saved_and_ends_with_an_error(full: bool) -> None:
    if not full:
        pytest.skip("takes minutes: `pytest tests/chaos` runs it")
    with run_folder() as run, Command(*WORDS, f"run={run}", env=ENV) as command:
        command.until(lambda: step(run) > 2, "first iterations", timeout_s=START_S)
        counter_file, started = run / "actors" / "actor-0.count", set[int]()

        def failed() -> bool:
            incarnation, _ = read_counts(counter_file)[-1]
            if incarnation not in started:
                started.add(incarnation)
                for actor in find(command, "ray::ActorProcess"):
                    actor.kill()
            return "0 of 1 actors are left" in command.err

        command.until(failed, "end of the run", timeout_s=START_S)
        assert command.wait() == 1
        error = r"giirl: 0 of 1 actors are left, wanted 1 \(actors\.min_healthy\): .+"
        assert re.search(error, command.err), command.err
        assert len(started) == MAX_CRASHES
        assert command.wait_leftover() == []
        assert latest_checkpoint(run / "checkpoints").is_dir()


def test_a_hung_actor_and_a_dead_reward_service_are_replaced_while_the_run_goes_on(full: bool) -> None:
    if not full:
        pytest.skip("takes minutes: `pytest tests/chaos` runs it")
    with run_folder() as run, Command(*WORDS, f"run={run}", env=ENV) as command:
        command.until(lambda: step(run) > 2, "first iterations", timeout_s=START_S)
        (hung,) = find(command, "ray::ActorProcess")
        hung.send_signal(signal.SIGSTOP)
        command.until(lambda: hung not in find(command, "ray::ActorProcess"), "end of the hung actor", timeout_s=90)
        assert_goes_on(command, run)
        first, second = find(command, "ray::RewardProcess")
        first.kill()
        assert_goes_on(command, run)
        command.until(lambda: len(find(command, "ray::RewardProcess")) == 2, "a new replica", timeout_s=90)
        assert second in find(command, "ray::RewardProcess")
        command.stop(signal.SIGINT)
        assert command.wait(timeout_s=90) == 130, command.err
        assert command.wait_leftover() == []
        assert unaccounted(run, run / "actors/actor-0.count") == 0


def test_actor_reward_service_and_learner_go_on_after_an_abort(full: bool) -> None:
    """A failed assertion in a library written in C++ ends a process with SIGABRT."""
    if not full:
        pytest.skip("takes minutes: `pytest tests/chaos` runs it")
    words = [word.replace("every=1000", "every=5").replace("replicas=2", "replicas=1") for word in WORDS]
    with run_folder() as run:
        with Command(*words, f"run={run}", env=ENV) as first:
            first.until(lambda: step(run) > 2, "first iterations", timeout_s=START_S)
            for title in ("ray::ActorProcess", "ray::RewardProcess"):
                (process,) = find(first, title)
                process.send_signal(signal.SIGABRT)
                first.until(
                    lambda process=process, title=title: find(first, title) not in ([], [process]),  # type: ignore[misc]
                    f"a new {title}",
                    timeout_s=90,
                )
                assert_goes_on(first, run)
            first.stop(signal.SIGABRT)
            assert first.wait() == -signal.SIGABRT
            reached = step(run)
            with Command("train", "--resume", str(run), env=ENV) as second:
                second.until(lambda: step(run) > reached + 5, "further iterations", timeout_s=START_S)
                second.stop(signal.SIGINT)
                assert second.wait(timeout_s=90) == 130, second.err
                assert second.wait_leftover() == []
            assert first.wait_leftover(timeout_s=RAY_CLEANUP_S) == []
        assert unaccounted(run, run / "actors/actor-0.count") == 0


def test_a_learner_that_is_resumed_on_a_cluster_reattaches_its_actors_and_replicas(full: bool) -> None:
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
            (counts,) = head.temporary.glob(f"giirl-*/{(run / 'identity').read_text()}/actor-0.count")
            (run / "linked.count").hardlink_to(counts)  # the actor deletes its count at the end
            second.stop(signal.SIGTERM)
            assert second.wait(timeout_s=90) == 130, second.err
        assert not counts.exists()
        assert unaccounted(run, run / "linked.count") == 0
