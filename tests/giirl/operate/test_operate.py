"""`giirl status`, `stop` and `clean`, and what they say of runs that are under way, finished, or dead."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest

from giirl.operate.clean import clean_up
from giirl.operate.status import lines, read_status
from giirl.operate.stop import stop_requests, stop_run
from giirl.run.folder import RunFolder
from giirl_core.files import folder_lock, write_json
from giirl_core.metrics import Metrics
from giirl_core.telemetry.targets import target_groups, write_targets
from giirl_core.temporary import user_folder
from tests.giirl.small import config, run


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The temporary folder of this Unix user, empty, on a machine that belongs to no cluster."""
    monkeypatch.setattr("giirl.operate.clean._clean_cluster", lambda identities, dry_run: [])
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return user_folder()


def learner_metrics() -> Metrics:
    """The metrics of a learner in the middle of a run."""
    metrics = Metrics()
    metrics.enter("training")
    metrics.policy_version.set(120)
    metrics.iterations_goal.set(300)
    metrics.checkpoint_time.set(time.time() - 65)
    metrics.success.labels("click-test").set(1.0)
    metrics.success.labels("click-button").set(0.74)
    flow = {"episodes_per_s": 38.1, "env_steps_per_s": 190.2, "iterations_per_s": 1.2, "lag": 2.4, "stale": 0.0}
    for key, value in {**flow, "learner_waits": 0.01, "actors_idle": 0.54}.items():
        metrics.flow.labels(key).set(value)
    metrics.trajectories_lost.inc(3)
    metrics.trajectories_dropped.labels("stale").inc(0)
    metrics.trajectories_queued.set(12)
    for kind, state, count in (("actor", "running", 3), ("actor", "waiting", 1), ("reward-service", "running", 2)):
        metrics.workers.labels(kind, state).set(count)
    return metrics


def test_the_status_of_a_run_under_way_says_all_an_operator_asks(tmp_path: Path) -> None:
    folder = RunFolder.create(config(tmp_path / "run"), "test")
    metrics = learner_metrics()
    address = metrics.serve()
    try:
        write_targets(folder.targets, target_groups("run", {"learner": address, "actor-0": "127.0.0.1:9"}))
        status = read_status(str(folder.path))
        by_address = read_status(address)
    finally:
        metrics.close()
    assert (by_address.run, by_address.workers) == (address, status.workers)
    assert lines(status) == [
        f"{folder.path}: training; iteration 120 of 300, 2:30 left",
        "  success         click-test 100 %, click-button 74 %",
        "  rate            38.1 episodes/s, 190.2 steps/s",
        "  waiting         the learner for episodes 1 % of its time, the actors for the learner 54 %",
        "  lag             2.4 versions; 12 episodes in the queue",
        "  dropped         lost 3",
        "  actor           3 running, 1 waiting",
        "  reward-service  2 running",
        "  saved           1:05 ago",
    ]
    assert json.loads(status.to_json())["workers"] == {
        "actor": {"running": 3, "waiting": 1},
        "reward-service": {"running": 2},
    }


def test_a_run_says_its_goal_and_success_in_its_metrics(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    metrics = Metrics()
    monkeypatch.setattr("giirl.run.train.Metrics", lambda kind: metrics)
    run(tmp_path / "run")
    value = metrics.registry.get_sample_value
    assert (value("giirl_iterations_goal"), value("giirl_policy_version")) == (4, 4)
    assert value("giirl_run_phase", {"phase": "evaluation"}) == 1
    assert value("giirl_run_phase", {"phase": "training"}) == 0
    assert 0 <= (value("giirl_success_ratio", {"task": "click-test"}) or 0) <= 1
    assert (value("giirl_checkpoint_timestamp_seconds") or 0) > time.time() - 60
    assert (value("giirl_flow", {"key": "iterations_per_s"}) or 0) > 0


@pytest.mark.parametrize(
    ("state", "said"),
    [
        ("killed", "run: not running; to go on: giirl train --resume "),
        ("finished", "run: finished; its result is in result.json; iteration 0 of 4"),
        ("locked", "run: under way, but its learner does not answer; is it on another machine?"),
    ],
)
def test_a_run_whose_learner_does_not_answer_is_told_from_its_folder(state: str, said: str, tmp_path: Path) -> None:
    folder = RunFolder.create(config(tmp_path / "run"), "test")
    write_targets(folder.targets, target_groups("run", {"learner": "127.0.0.1:9"}))
    if state == "finished":
        write_json(folder.result, {})
    if state == "locked":
        with folder_lock(folder.path):
            assert said in lines(read_status(str(folder.path)))[0]
    else:
        assert said in lines(read_status(str(folder.path)))[0]


@pytest.mark.parametrize(
    ("word", "error"),
    [
        ("127.0.0.1:9", r"nobody answers at 127\.0\.0\.1:9: the run has ended, or"),
        ("no/such/run", "there is no run folder no/such/run: wanted the folder of a run, or HOST:PORT"),
    ],
)
def test_a_status_of_nothing_is_an_error_that_says_what_is_wanted(word: str, error: str) -> None:
    with pytest.raises(ValueError, match=error):
        read_status(word)


def test_stop_sends_sigterm_to_the_process_of_the_run_and_waits_for_its_end(tmp_path: Path) -> None:
    folder = RunFolder.create(config(tmp_path / "run"), "test")
    ready, child = os.pipe()
    pid = os.fork()
    if not pid:  # a run that only waits for the signal
        signal.signal(signal.SIGTERM, lambda number, frame: os._exit(0))
        with folder_lock(folder.path), stop_requests(folder):
            os.write(child, b"r")
            time.sleep(60)
        os._exit(1)
    assert os.read(ready, 1) == b"r"
    assert stop_run(folder.path, 20.0) == f"{folder.path} is stopped; to resume: giirl train --resume {folder.path}"
    assert os.waitpid(pid, 0)[1] == 0
    assert not (folder.path / "stop").exists()
    with pytest.raises(ValueError, match=r"no process runs .*; to remove what it left: giirl clean"):
        stop_run(folder.path, 1.0)


def test_a_request_from_before_does_not_stop_the_next_session(tmp_path: Path) -> None:
    folder = RunFolder.create(config(tmp_path / "run"), "test")
    (folder.path / "stop").touch()
    with stop_requests(folder):
        time.sleep(0.5)
    assert not (folder.path / "stop").exists()


def test_clean_removes_what_a_dead_run_left_and_nothing_of_a_run_under_way(temporary: Path, tmp_path: Path) -> None:
    dead, living = (RunFolder.create(config(tmp_path / name), "test") for name in ("dead", "living"))
    for folder in (dead, living):
        (temporary / folder.identity).mkdir()
        (temporary / folder.identity / "actor-0.count").touch()
    (dead.checkpoints / ".partial-00000007").mkdir(parents=True)
    with (temporary / living.identity / "actor-0.count").open():
        assert clean_up([dead.path], dry_run=True) == clean_up([dead.path], dry_run=False)
        assert not (temporary / dead.identity).exists()
        assert list(dead.checkpoints.iterdir()) == []
        assert clean_up([], dry_run=False) == []
    assert (temporary / living.identity / "actor-0.count").exists()
    with folder_lock(living.path), pytest.raises(ValueError, match=r"is under way: giirl stop .* first"):
        clean_up([living.path], dry_run=False)


def test_actors_of_a_run_that_is_over_cannot_be_changed(tmp_path: Path) -> None:
    from click.testing import CliRunner

    from giirl.cli.actors import actors

    folder = RunFolder.create(config(tmp_path / "run", "runtime=local"), "test")
    answer = CliRunner().invoke(actors, [str(folder.path), "5"])
    assert "is not running: it has no actors to change; to go on: giirl train --resume" in str(answer.exception)
    write_json(folder.result, {})
    assert "has ended" in str(CliRunner().invoke(actors, [str(folder.path), "5"]).exception)
    with folder_lock(folder.path):
        assert CliRunner().invoke(actors, [str(folder.path), "5"]).exit_code == 0
