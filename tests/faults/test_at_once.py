"""Two runs at once have folders of their own, and signals save: what reaches a run from outside."""

from __future__ import annotations

import errno
import json
import multiprocessing
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from giirl.run.folder import RunFolder
from giirl.run.serial import SerialRuntime
from giirl_core.config_file import load_config
from tests.command import Command
from tests.giirl.small import SETTINGS, config

FEW = (*SETTINGS, "iterations=2", "evaluate.episodes=1", "evaluate.random_episodes=1")


# ---- two at once


def together(count: int, work: Callable[[int], object]) -> list[object]:
    """What `work` returns or raises in `count` threads that begin it at the same moment."""
    barrier, answers = threading.Barrier(count), [object()] * count

    def begin(number: int) -> None:
        barrier.wait()
        try:
            answers[number] = work(number)
        except ValueError as error:
            answers[number] = error

    threads = [threading.Thread(target=begin, args=(number,)) for number in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    return answers


def test_runs_that_begin_in_the_same_second_have_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time, "strftime", lambda form: "20260101-000000")
    for _ in range(10):
        folders = together(4, lambda seed: RunFolder.create(load_config(None, [f"seed={seed}"]), "mine"))
        paths = [folder.path for folder in folders if isinstance(folder, RunFolder)]
        assert len(set(paths)) == 4
        assert [json.loads((path / "config.json").read_text())["seed"] for path in paths] == [0, 1, 2, 3]
        shutil.rmtree(tmp_path / "runs")


def test_of_runs_that_begin_in_one_folder_at_once_one_goes_on_under_its_own_config(tmp_path: Path) -> None:
    for number in range(40):
        path = tmp_path / str(number)
        done = threading.Event()

        def begin(seed: int, path: Path = path, done: threading.Event = done) -> int:
            with RunFolder.started(config(path, f"seed={seed}"), "mine") as folder:
                done.wait(0.02)
                return int(json.loads(folder.config_file.read_text())["seed"]) - seed

        answers = together(4, begin)
        assert answers.count(0) >= 1  # they may also come one after the other
        assert all(answer == 0 or "another process uses" in str(answer) for answer in answers), answers


def test_a_second_process_does_not_get_into_a_run_that_python_created(tmp_path: Path) -> None:
    mine = RunFolder.create(config(tmp_path / "run"), "mine")
    with mine.held():
        fork = multiprocessing.get_context("fork")
        queue: Any = fork.Queue()

        def other() -> None:
            try:
                RunFolder.create(config(tmp_path / "run", "seed=7"), "theirs")
            except ValueError as error:
                queue.put(str(error))

        child = fork.Process(target=other)
        child.start()
        assert "another process uses" in queue.get(timeout=30)
        child.join(30)
    RunFolder.create(config(tmp_path / "run", "seed=7"), "theirs")  # in between
    with pytest.raises(ValueError, match="another process began a run"), mine.held():
        raise AssertionError


# ---- signals


def test_a_closing_terminal_saves_the_run_although_it_sends_its_signal_twice(
    giirl: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    take = SerialRuntime.take

    def hung_up(self: SerialRuntime, episodes: int) -> Any:
        signal.raise_signal(signal.SIGHUP)
        signal.raise_signal(signal.SIGHUP)
        return take(self, episodes)

    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests themselves may run under nohup
    with monkeypatch.context() as patch:
        patch.setattr(SerialRuntime, "take", hung_up)
        answer = giirl("train", *FEW, "run=out")
    assert answer.status == 130
    assert (tmp_path / "out/checkpoints/latest").read_text() == "step-00000001"
    assert giirl("train", "--resume", "out").status == 0


def test_under_nohup_a_closing_terminal_changes_nothing(giirl: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    take = SerialRuntime.take

    def hung_up(self: SerialRuntime, episodes: int) -> Any:
        signal.raise_signal(signal.SIGHUP)
        return take(self, episodes)

    monkeypatch.setattr(SerialRuntime, "take", hung_up)
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert giirl("train", *FEW, "run=out").status == 0


class Unreadable:
    """Standard error after its terminal was closed."""

    def write(self, text: str) -> int:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    def flush(self) -> None:
        raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE))

    def isatty(self) -> bool:
        return True


def test_a_run_does_not_end_because_nobody_reads_its_messages(
    giirl: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", Unreadable())
        assert giirl("train", *FEW, "run=out").status == 0
    assert (tmp_path / "out/result.json").exists()
