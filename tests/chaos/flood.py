"""A learner that stops, and a thousand actors that offer all the same: what becomes of everybody's memory.

python -m tests.chaos.flood FOLDER SETTINGS (JSON) writes FOLDER/flood.json.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

import psutil

from tests.chaos.crowd import crowd, finished, read_version
from tests.chaos.storm import free_ports, settle_accounts, start
from tests.chaos.trainer import SLOW, train

UNTIL_S = 120.0


def main() -> None:
    folder, settings = Path(sys.argv[1]), json.loads(sys.argv[2])
    players = settings["actors"] // settings["crowds"]
    (port,) = free_ports(1)
    trainer = start("trainer", lambda: train(folder, port))
    crowds = [
        start(
            f"crowd-{place}",
            lambda place=place: crowd(  # type: ignore[misc]
                folder,
                f"127.0.0.1:{port}",
                range(place * players, (place + 1) * players),
                0,
                size=settings["size"],
            ),
        )
        for place in range(settings["crowds"])
    ]
    try:
        _until(lambda: len(_playing(folder)) == settings["actors"], "episodes of every actor")
        _until(lambda: read_version(folder) > 100, "a hundred steps")
        seen = {
            "process": _stop_process(folder, trainer, crowds, settings["stop_s"]),
            "updates": _stop_updates(folder, trainer, crowds, settings["stop_s"]),
        }
        for pid in [*crowds, trainer]:
            os.kill(pid, signal.SIGTERM)
            os.waitpid(pid, 0)
        (folder / "flood.json").write_text(json.dumps({**seen, "ledger": settle_accounts(folder)}, indent=2) + "\n")
    finally:
        for pid in [trainer, *crowds]:
            if psutil.pid_exists(pid) and psutil.Process(pid).ppid() == os.getpid():
                os.kill(pid, signal.SIGKILL)


def _stop_process(folder: Path, trainer: int, crowds: list[int], stop_s: float) -> dict[str, float]:
    """The learner's whole process hears nobody."""
    before = _playing(folder)
    os.kill(trainer, signal.SIGSTOP)
    found = _watch(trainer, crowds, stop_s)
    os.kill(trainer, signal.SIGCONT)
    return {**found, "resumed": _resumed(folder, before)}


def _stop_updates(folder: Path, trainer: int, crowds: list[int], stop_s: float) -> dict[str, float]:
    """The learner hears everybody, and takes nothing: one update lasts that long."""
    before = _playing(folder)
    (folder / SLOW).write_text(str(stop_s + 2.0))
    step = read_version(folder)
    _until(lambda: read_version(folder) > step, "the step that lasts")
    (folder / SLOW).write_text("0")
    found = _watch(trainer, crowds, stop_s)
    return {**found, "resumed": _resumed(folder, before)}


def _watch(trainer: int, crowds: list[int], stop_s: float) -> dict[str, float]:
    """Resident memory once everybody has noticed, and how much it differs at the end; MiB."""
    time.sleep(stop_s / 6)
    early = _memory([trainer]), _memory(crowds)
    time.sleep(5 * stop_s / 6)
    late = _memory([trainer]), _memory(crowds)
    return {"learner_mib": early[0], "actors_mib": early[1], "learner_late_mib": late[0], "actors_late_mib": late[1]}


def _memory(pids: list[int]) -> float:
    resident: int = sum(psutil.Process(pid).memory_info().rss for pid in pids)
    return round(resident / 2**20, 1)


def _playing(folder: Path) -> dict[tuple[int, int], int]:
    return {who: count for who, count in finished(folder).items() if count}


def _resumed(folder: Path, before: dict[tuple[int, int], int]) -> int:
    """How many actors finished something since; waits until all have, at most so long."""
    deadline_s = time.monotonic() + UNTIL_S
    while time.monotonic() < deadline_s:
        now = finished(folder)
        on = sum(now[who] > count + 4 for who, count in before.items())  # more than was under way
        if on == len(before):
            break
        time.sleep(0.5)
    return on


def _until(true: object, what: str) -> None:
    deadline_s = time.monotonic() + UNTIL_S
    while not true():  # type: ignore[operator]
        if time.monotonic() > deadline_s:
            raise AssertionError(f"no {what} within {UNTIL_S} s")
        time.sleep(0.1)


if __name__ == "__main__":
    main()
