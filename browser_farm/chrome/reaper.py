"""Ends every Chrome process of a farm once its owner is gone, however the owner ended, SIGKILL included.

It runs as a process of its own, started before Chrome: `python reaper.py FARM_DIRECTORY OWNER`, with a pipe from
the owner as standard input. Nothing is ever written to that pipe, so the end of it is the end of the owner.
It is nobody's child: a Ray worker whose node is gone kills its children, and then ends itself.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

MARK = "GIIRL_FARM_DIRECTORY"  # set in the environment of chromedriver, and so of all it starts
GIVE_UP_S = 10.0


class Reaper:
    """The owner's end of a reaper."""

    def __init__(self, directory: Path) -> None:
        self._parent = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__, str(directory), str(os.getpid())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            cwd="/",
        )
        assert self._parent.stdout is not None
        self._life = self._parent.stdout  # ends with the reaper
        self._pid = int(self._life.readline())
        self._parent.wait()

    def end(self) -> None:
        """Set it to work, and wait until it is done."""
        assert self._parent.stdin is not None
        self._parent.stdin.close()
        end = select.poll()
        end.register(self._life)
        if not end.poll(2000 * GIVE_UP_S):
            os.kill(self._pid, signal.SIGKILL)
        self._life.close()


def processes(directory: Path) -> set[int]:
    """The pids that belong to `directory`: by environment, by command line, by session, or by descent."""
    mark = f"{MARK}={directory}".encode()
    profile = f"--user-data-dir={directory}/".encode()
    parents: dict[int, int] = {}
    sessions: dict[int, int] = {}
    found: set[int] = set()
    for path in Path("/proc").iterdir():
        entry = path.name
        if not entry.isdigit() or int(entry) == os.getpid():
            continue
        try:
            stat = (path / "stat").read_text(errors="replace")
            command = (path / "cmdline").read_bytes()
            environment = (path / "environ").read_bytes()
        except OSError:
            continue  # it ended while being looked at, or belongs to somebody else
        state, parent, _, session = stat.rpartition(")")[2].split()[:4]
        if state == "Z":
            continue  # ended already; only its own parent can take it off the list
        parents[int(entry)], sessions[int(entry)] = int(parent), int(session)
        if mark in environment.split(b"\0") or profile in command:
            found.add(int(entry))
    own_sessions = {sessions[pid] for pid in found} - {os.getsid(0), 0}
    while True:
        more = {
            pid
            for pid, parent in parents.items()
            if pid not in found and (parent in found or sessions[pid] in own_sessions)
        }
        if not more:
            return found
        found |= more


def reap(directory: Path, *, timeout_s: float = GIVE_UP_S) -> None:
    """Kill all that belongs to `directory` until two looks in a row find nothing, then remove it."""
    deadline = time.monotonic() + timeout_s
    quiet_looks = 0
    while quiet_looks < 2 and time.monotonic() < deadline:
        pids = processes(directory)
        quiet_looks = 0 if pids else quiet_looks + 1
        for pid in pids:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue  # it was faster
        time.sleep(0.02)
    shutil.rmtree(directory, ignore_errors=True)


def main(directory: Path, owner: int) -> None:
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)
    pid = os.fork()
    if pid:
        print(pid, flush=True)  # noqa: T201, the owner reads it
        return
    try:
        gone = os.pidfd_open(owner)  # a fork of the owner may hold the pipe open, so look for the owner as well
    except ProcessLookupError:
        gone = 0
    while True:
        readable, _, _ = select.select([0, gone], [], [])
        if gone in readable or not os.read(0, 1):
            break
    reap(directory)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
