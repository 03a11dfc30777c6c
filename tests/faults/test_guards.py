"""Disks without file locks, or without sync: the guard that is missing is a warning, and a run goes on."""

from __future__ import annotations

import errno
import fcntl
import logging
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from actors.episode_counter import EpisodeCounter, Replaced, read_counts
from giirl_core.files import folder_lock, write_json
from tests.command import Command
from tests.giirl.small import SETTINGS

FEW = (*SETTINGS, "iterations=1", "evaluate.episodes=1", "evaluate.random_episodes=1")


def failing(number: int, when: Callable[[int], bool] = lambda file: True) -> Callable[..., None]:
    """A call on an open file that the file system refuses, for the files for which `when` is true."""

    def refused(file: int, *rest: Any) -> None:
        if when(file):
            raise OSError(number, os.strerror(number))

    return refused


def is_folder(file: int) -> bool:
    return stat.S_ISDIR(os.fstat(file).st_mode)


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EBADF])
def test_a_run_on_a_disk_without_locks_warns_and_goes_on(
    number: int, giirl: Command, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(fcntl, "flock", failing(number))
    answer = giirl("train", *FEW, "run=out")
    assert answer.status == 0, answer.err
    assert giirl("train", "--resume", "out", "iterations=2").status == 0
    warnings = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert warnings.count(f"out cannot be locked ({os.strerror(number)}): take care that no two processes use it") == 1


@pytest.mark.parametrize(
    ("number", "when"),
    [(errno.EINVAL, is_folder), (errno.EOPNOTSUPP, lambda file: True)],
    ids=["folders", "folders and files"],
)
def test_a_run_on_a_disk_that_cannot_sync_warns_and_goes_on(
    number: int,
    when: Callable[[int], bool],
    giirl: Command,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(os, "fsync", failing(number, when))
    answer = giirl("train", *FEW, "run=out")
    assert answer.status == 0, answer.err
    assert giirl("train", "--resume", "out", "iterations=2").status == 0
    text = caplog.text
    assert f"cannot be synced to the disk ({os.strerror(number)}): the newest may be lost when the power fails" in text


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC, errno.EDQUOT])
def test_data_that_did_not_reach_the_disk_is_an_error_and_leaves_the_old_file(
    number: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_json(tmp_path / "a.json", 1)
    monkeypatch.setattr(os, "fsync", failing(number))
    with pytest.raises(OSError, match=os.strerror(number)):
        write_json(tmp_path / "a.json", 2)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a.json", "1\n")]


def test_a_disk_without_permissions_is_written_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(self: Path, mode: int) -> None:
        raise PermissionError(errno.EPERM, os.strerror(errno.EPERM), str(self))

    monkeypatch.setattr(Path, "chmod", refused)
    write_json(tmp_path / "a.json", 1)
    assert (tmp_path / "a.json").read_text() == "1\n"


def test_an_actor_on_a_disk_without_locks_counts_its_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fcntl, "flock", failing(errno.ENOLCK))
    counter = EpisodeCounter(tmp_path / "actor-0.count", 5)
    assert [counter.add(), counter.add()] == [0, 1]
    successor = EpisodeCounter(tmp_path / "actor-0.count", 6)
    assert successor.before == ((5, 2),)
    with pytest.raises(Replaced):
        counter.add()
    assert read_counts(tmp_path / "actor-0.count") == ((5, 2), (6, 0))
    counter.close()
    successor.close()


def test_a_lock_that_another_process_holds_is_still_an_error(tmp_path: Path) -> None:
    with (
        folder_lock(tmp_path),
        pytest.raises(ValueError, match=r"another process uses .*: wait until it ends, or stop it"),
        folder_lock(tmp_path),
    ):
        raise AssertionError


def test_the_lock_of_a_folder_that_was_removed_meanwhile_protects_nothing_and_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    flock = fcntl.flock

    def late(file: int, operation: int) -> None:
        folder.rmdir()
        folder.mkdir()
        flock(file, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with pytest.raises(ValueError, match="another process has just removed"), folder_lock(folder):
        raise AssertionError
