"""A learner that stops while a thousand actors try to deliver: how much memory both sides need.

python -m tests.chaos.flood FOLDER SETTINGS (JSON) writes FOLDER/flood.json.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from tests.chaos.crowd import finished_counts, read_version, run_actors
from tests.chaos.storm import compute_ledger, free_ports, start
from tests.chaos.trainer import UPDATE_S_FILE, train

TIMEOUT_S = 120.0


def main() -> None:
    folder, settings = Path(sys.argv[1]), json.loads(sys.argv[2])
    actors_per_crowd = settings["actors"] // settings["crowds"]
    (port,) = free_ports(1)
    trainer = start("trainer", lambda: train(folder, port))
    crowds = [
        start(
            f"crowd-{index}",
            lambda index=index: run_actors(  # type: ignore[misc]
                folder,
                f"127.0.0.1:{port}",
                range(index * actors_per_crowd, (index + 1) * actors_per_crowd),
                0,
                size=settings["size"],
            ),
        )
        for index in range(settings["crowds"])
    ]
    try:
        _wait_until(lambda: len(_active(folder)) == settings["actors"], "episodes of every actor")
        _wait_until(lambda: read_version(folder) > 100, "a hundred steps")
        result = {
            "process": _suspend_learner(folder, trainer, crowds, settings["stop_s"]),
            "updates": _slow_update(folder, trainer, crowds, settings["stop_s"]),
        }
        for pid in [*crowds, trainer]:
            os.kill(pid, signal.SIGTERM)
            os.waitpid(pid, 0)
        (folder / "flood.json").write_text(json.dumps({**result, "ledger": compute_ledger(folder)}, indent=2) + "\n")
    finally:
        for pid in [trainer, *crowds]:
            if psutil.pid_exists(pid) and psutil.Process(pid).ppid() == os.getpid():
                os.kill(pid, signal.SIGKILL)


def _suspend_learner(folder: Path, trainer: int, crowds: list[int], stop_s: float) -> dict[str, float]:
    """Suspend the learner's process, so that it receives nothing."""
    before = _active(folder)
    os.kill(trainer, signal.SIGSTOP)
    memory = _measure_memory(trainer, crowds, stop_s)
    os.kill(trainer, signal.SIGCONT)
    return {**memory, "resumed": _wait_resumed(folder, before)}


def _slow_update(folder: Path, trainer: int, crowds: list[int], stop_s: float) -> dict[str, float]:
    """Make one update last longer than `stop_s`: the learner receives messages, but takes no episodes."""
    before = _active(folder)
    (folder / UPDATE_S_FILE).write_text(str(stop_s + 2.0))
    step = read_version(folder)
    _wait_until(lambda: read_version(folder) > step, "the slow update")
    (folder / UPDATE_S_FILE).write_text("0")
    memory = _measure_memory(trainer, crowds, stop_s)
    return {**memory, "resumed": _wait_resumed(folder, before)}


def _measure_memory(trainer: int, crowds: list[int], stop_s: float) -> dict[str, float]:
    """Resident memory in MiB, early (after a sixth of `stop_s`) and late (at its end)."""
    time.sleep(stop_s / 6)
    early = _memory([trainer]), _memory(crowds)
    time.sleep(5 * stop_s / 6)
    late = _memory([trainer]), _memory(crowds)
    return {"learner_mib": early[0], "actors_mib": early[1], "learner_late_mib": late[0], "actors_late_mib": late[1]}


def _memory(pids: list[int]) -> float:
    resident: int = sum(psutil.Process(pid).memory_info().rss for pid in pids)
    return round(resident / 2**20, 1)


def _active(folder: Path) -> dict[tuple[int, int], int]:
    return {incarnation: count for incarnation, count in finished_counts(folder).items() if count}


def _wait_resumed(folder: Path, before: dict[tuple[int, int], int]) -> int:
    """Wait until all actors have finished further episodes, at most TIMEOUT_S; returns how many have."""
    deadline_s = time.monotonic() + TIMEOUT_S
    while time.monotonic() < deadline_s:
        now = finished_counts(folder)
        resumed = sum(now[key] > count + 4 for key, count in before.items())  # at most 4 are unacknowledged
        if resumed == len(before):
            break
        time.sleep(0.5)
    return resumed


def _wait_until(condition: Callable[[], bool], what: str) -> None:
    deadline_s = time.monotonic() + TIMEOUT_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise AssertionError(f"no {what} within {TIMEOUT_S} s")
        time.sleep(0.1)


if __name__ == "__main__":
    main()
