"""Disks that are full, read-only or somebody else's: one line says what, where and how, and nothing saved is lost."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from giirl.run.serial import SerialRuntime
from giirl_core.files import atomic_write, check_writable, write_json
from giirl_core.types import Episode
from learner.checkpoint import latest_checkpoint
from tests.command import Command
from tests.faults.disks import fill, nobody, read_only, small_disk
from tests.giirl.small import SETTINGS, run

PLAYED = "making demonstrations"  # what a command says when it begins to work
FULL = "No space left on device; free some space there, or choose another folder"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A finished run and its result."""
    path = tmp_path_factory.mktemp("finished") / "run"
    return path, run(path)


def filling(disk: Path, call: int) -> Callable[[SerialRuntime, int], list[Episode]]:
    """`SerialRuntime.take`, which fills the disk at one of its calls."""
    take, calls = SerialRuntime.take, []

    def filled(self: SerialRuntime, episodes: int) -> list[Episode]:
        calls.append(episodes)
        if len(calls) == call:
            fill(disk)
        return take(self, episodes)

    return filled


def test_a_run_that_a_full_disk_ended_goes_on_with_the_command_that_the_message_names(
    giirl: Command, finished: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with small_disk(tmp_path / "disk", 4000) as disk:
        with monkeypatch.context() as patch:
            patch.setattr(SerialRuntime, "take", filling(disk, 2))
            error = giirl("train", *SETTINGS, "run=disk/out").error
        assert FULL in error
        assert "disk/out" in error
        assert "Errno" not in error
        assert ".partial" not in error  # the user did not name that file
        assert list((disk / "out/checkpoints").glob(".partial-*")) == []  # it would take the space that is missing
        assert latest_checkpoint(disk / "out/checkpoints").name == "step-00000000"
        words = error.partition("to resume: giirl ")[2].split()
        assert FULL in giirl(*words).error  # still full
        (disk / "ballast").unlink()
        assert giirl(*words).status == 0
        result = json.loads((disk / "out/result.json").read_text())
        assert result["parameters_sha256"] == finished[1]["parameters_sha256"]


@pytest.mark.parametrize("kilobytes", [4, 40, 100])
def test_a_run_whose_first_checkpoint_does_not_fit_begins_again_with_the_same_command(
    kilobytes: int, giirl: Command, tmp_path: Path
) -> None:
    words = ("train", *SETTINGS, "iterations=1", "run=disk/out")
    with small_disk(tmp_path / "disk", 4000) as disk:
        fill(disk)
        os.truncate(disk / "ballast", (disk / "ballast").stat().st_size - kilobytes * 1024)
        error = giirl(*words).error
        assert FULL in error
        assert "disk/out" in error
        (disk / "ballast").unlink()
        assert giirl(*words).status == 0


def test_a_result_that_does_not_fit_is_made_again_from_the_saved_run(
    giirl: Command, finished: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, value: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as patch:
        patch.setattr("giirl.run.api.write_json", full)
        error = giirl("train", *SETTINGS, "run=out").error
    assert "step-00000004 is saved, to resume: giirl train --resume out" in error
    assert giirl("train", "--resume", "out").status == 0
    assert json.loads(Path("out/result.json").read_text())["parameters_sha256"] == finished[1]["parameters_sha256"]


@pytest.mark.parametrize(
    "words",
    [
        ("train", *SETTINGS, "run=ro/out"),
        ("train", *SETTINGS, "run=out", "--json", "ro/a.json"),
        ("train", "--resume", "ro/run"),
        ("demos", "make", "--browser", "fake", "--out", "ro/a.giirl"),
        ("evaluate", "ro/run", "--json", "ro/a.json"),
        ("report", "ro/run"),
        ("reward", "inspect", "ro/run", "--task", "click-button", "--seed", "1"),
        ("reproduce", "figure-4.3", "--out", "ro/figures"),
        ("reproduce", "all", "--out", "ro/all"),
    ],
    ids=" ".join,
)
def test_a_place_that_cannot_be_written_is_an_error_before_any_work(
    words: tuple[str, ...], giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    (tmp_path / "ro").mkdir()
    (tmp_path / "ro/run").symlink_to(finished[0])
    with read_only(tmp_path / "ro"), read_only(finished[0]):
        answer = giirl(*words)
        assert "Read-only file system; choose a folder that can be written" in answer.error
        assert "ro/" in answer.error
        assert "/." not in answer.error  # no temporary file
        assert len(answer.err.splitlines()) == 1  # nothing was played or measured
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ro"]


def test_a_run_on_a_read_only_disk_can_be_evaluated(
    giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    with read_only(finished[0]):
        assert giirl("evaluate", finished[0], "--json", "a.json").status == 0
    assert json.loads((tmp_path / "a.json").read_text())["tasks"] == finished[1]["tasks"]


def test_a_folder_of_another_user_is_an_error_that_names_the_file_that_was_given(tmp_path: Path) -> None:
    (tmp_path / "theirs").mkdir(mode=0o755)
    for parent in (tmp_path, *tmp_path.parents[:2]):
        parent.chmod(0o755)
    wanted = tmp_path / "theirs/a.json"
    with nobody(), pytest.raises(PermissionError) as caught:
        check_writable(wanted)
    assert caught.value.filename == str(wanted)
    assert list((tmp_path / "theirs").iterdir()) == []


def test_a_name_that_is_too_long_for_the_disk_is_found_before_the_work(giirl: Command) -> None:
    name = "a" * 250  # it fits, but not with what a temporary file has in addition
    error = giirl("demos", "make", "--browser", "fake", "--out", name).error
    assert "File name too long; choose a shorter name" in error


def test_what_is_no_file_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    check_writable(tmp_path / "pipe")
    write_json(tmp_path / "pipe", 7)
    assert os.read(reader, 100) == b"7\n"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
    (tmp_path / "file").write_text("old")
    (tmp_path / "link").symlink_to("file")
    write_json(tmp_path / "link", 8)
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "8\n"


def test_an_error_in_an_atomic_write_names_the_file_and_leaves_the_old_one(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OSError, match="No space left") as caught, atomic_write(tmp_path / "a"):
        raise full
    assert caught.value.filename == str(tmp_path / "a")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "old")]
