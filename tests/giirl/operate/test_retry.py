"""`giirl train --resume-or-start`: the same command starts a run, goes on with it, and leaves a finished one alone."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import pytest

import giirl.run.train as giirl_run
from giirl.operate.retry import is_finished, resumed_or_started
from giirl.run.api import train
from giirl.run.folder import RunFolder
from giirl_core.config import Config
from giirl_core.config_file import load_config
from giirl_core.files import folder_lock
from giirl_core.progress import Display
from learner.checkpoint import LATEST, latest_checkpoint
from tests.giirl.small import config

FEW = ("iterations=6", "checkpoint_every=2", "evaluate.episodes=1", "evaluate.random_episodes=1")


def attempt(settings: Config) -> Path | None:
    """One try of the command in this process; returns the checkpoint that it went on from."""
    with resumed_or_started(settings) as (folder, settings, checkpoint):
        if not is_finished(folder, settings, checkpoint):
            train(settings, folder, checkpoint, Display())
        return checkpoint


def killed(settings: Config, call: str, number: int) -> None:
    """A try that is killed at the call of this number of a method of `Session` or of `Path`, as by SIGKILL."""
    pid = os.fork()
    if pid:
        assert os.waitpid(pid, 0)[1] == signal.SIGKILL
        return
    owner = giirl_run.Session if hasattr(giirl_run.Session, call) else Path
    original, calls = getattr(owner, call), []

    def dying(self: object, *values: object, **named: object) -> object:
        calls.append(call)
        if len(calls) == number:
            os.kill(os.getpid(), signal.SIGKILL)
        return original(self, *values, **named)

    setattr(owner, call, dying)
    try:
        attempt(settings)
    finally:
        os._exit(1)  # it was not killed


def steps(settings: Config) -> list[int]:
    return [point["step"] for point in RunFolder(Path(settings.run)).points()]


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")  # of Python 3.12; the fork only dies
@pytest.mark.parametrize(
    ("call", "number"),
    [("chmod", 1), ("chmod", 2), ("learn", 1), ("mkdir", 3), ("_observe", 1), ("_observe", 4), ("rename", 2)],
)
def test_the_same_command_goes_on_after_a_kill_at_any_moment(call: str, number: int, tmp_path: Path) -> None:
    settings = config(tmp_path / "run", *FEW)
    killed(settings, call, number)
    attempt(settings)
    assert steps(settings) == [1, 2, 3, 4, 5, 6]
    assert RunFolder(tmp_path / "run").result.is_file()


def test_a_finished_run_is_left_as_it_is(tmp_path: Path) -> None:
    settings = config(tmp_path / "run", *FEW)
    assert attempt(settings) is None
    result = RunFolder(tmp_path / "run").result.stat()
    assert attempt(settings) == latest_checkpoint(tmp_path / "run/checkpoints")
    assert RunFolder(tmp_path / "run").result.stat() == result


def test_more_iterations_are_trained_and_any_other_change_is_refused(tmp_path: Path) -> None:
    attempt(config(tmp_path / "run", *FEW))
    attempt(config(tmp_path / "run", *FEW, "iterations=8"))
    assert steps(config(tmp_path / "run")) == [1, 2, 3, 4, 5, 6, 7, 8]
    with pytest.raises(ValueError, match="is a run with another seed, wanted the same settings in every try"):
        attempt(config(tmp_path / "run", *FEW, "iterations=8", "seed=1"))


def test_what_demonstrations_show_is_the_same_in_every_try(tmp_path: Path) -> None:
    settings = config(tmp_path / "run", *FEW, "algorithm=wge")
    attempt(settings)
    saved = load_config(RunFolder(tmp_path / "run").config_file)
    assert saved.demos.workflows != settings.demos.workflows
    attempt(config(tmp_path / "run", *FEW, "algorithm=wge", "iterations=8"))
    assert load_config(RunFolder(tmp_path / "run").config_file).demos.workflows == saved.demos.workflows


def test_files_of_something_else_are_never_deleted(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ValueError, match="is not empty: choose another run=FOLDER"):
        attempt(config(tmp_path))
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_a_try_without_a_folder_is_refused() -> None:
    with pytest.raises(ValueError, match=r"--resume-or-start needs a folder .*: add run=FOLDER"):
        attempt(load_config(None, ["runtime=serial"]))


def test_a_try_waits_for_the_one_before_and_then_says_who_uses_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("giirl.operate.retry.LOCK_TIMEOUT_S", 0.3)
    settings = config(tmp_path, *FEW)
    with folder_lock(tmp_path), pytest.raises(ValueError, match="another process uses"):
        attempt(settings)


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_the_identity_of_a_try_without_a_checkpoint_stays(tmp_path: Path) -> None:
    settings = config(tmp_path / "run", *FEW)
    killed(settings, "_observe", 1)
    shutil.rmtree(tmp_path / "run/checkpoints")
    folder = RunFolder(tmp_path / "run")
    identity = folder.identity
    with resumed_or_started(settings) as (again, _, checkpoint):
        assert checkpoint is None
        again.clear()
        assert again.identity == identity
    assert not (folder.checkpoints / LATEST).exists()
