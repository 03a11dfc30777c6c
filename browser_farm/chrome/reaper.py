"""Kills every Chrome process of a farm once its owner has ended, even by SIGKILL.

It runs as a process of its own, started before Chrome: `python reaper.py FARM_DIRECTORY OWNER_PID`. Its standard input
is a pipe from the owner. Nothing is written to it, so end-of-file means that the owner has ended. The process detaches
from its parent, since a Ray worker whose node dies kills its children before it exits itself.
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

DIRECTORY_VARIABLE = "GIIRL_FARM_DIRECTORY"  # in the environment of chromedriver, which its children inherit
TIMEOUT_S = 10.0


class Reaper:
    """Starts the reaper process from the owner's side."""

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
        self._output = self._parent.stdout  # at end-of-file once the reaper has exited
        self._pid = int(self._output.readline())
        self._parent.wait()

    def end(self) -> None:
        """Let the reaper kill the processes, and wait until it has exited."""
        assert self._parent.stdin is not None
        self._parent.stdin.close()
        poller = select.poll()
        poller.register(self._output)
        if not poller.poll(2000 * TIMEOUT_S):  # milliseconds: twice its own timeout
            os.kill(self._pid, signal.SIGKILL)
        self._output.close()


def processes(directory: Path) -> set[int]:
    """The pids that belong to `directory` by environment, command line, session or parent process."""
    variable = f"{DIRECTORY_VARIABLE}={directory}".encode()
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
            continue  # it ended in the meantime, or belongs to another user
        state, parent, _, session = stat.rpartition(")")[2].split()[:4]
        if state == "Z":
            continue  # a zombie: only its parent can remove it
        parents[int(entry)], sessions[int(entry)] = int(parent), int(session)
        if variable in environment.split(b"\0") or profile in command:
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


def reap(directory: Path, *, timeout_s: float = TIMEOUT_S) -> None:
    """Kill all processes of `directory` until two scans in a row find none, then remove it."""
    deadline = time.monotonic() + timeout_s
    empty_scans = 0
    while empty_scans < 2 and time.monotonic() < deadline:
        pids = processes(directory)
        empty_scans = 0 if pids else empty_scans + 1
        for pid in pids:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue  # already gone
        time.sleep(0.02)
    shutil.rmtree(directory, ignore_errors=True)


def main(directory: Path, owner: int) -> None:
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)
    pid = os.fork()
    if pid:
        print(pid, flush=True)  # noqa: T201, the owner reads the pid
        return
    try:
        owner_exit = os.pidfd_open(owner)  # a fork of the owner may keep the pipe open: watch the owner as well
    except ProcessLookupError:
        owner_exit = 0
    while True:
        readable, _, _ = select.select([0, owner_exit], [], [])
        if owner_exit in readable or not os.read(0, 1):
            break
    reap(directory)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
