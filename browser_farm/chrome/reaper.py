"""The parent of one chromedriver: ends it and its Chrome when their owner says so or has ended, even by SIGKILL.

`python reaper.py FARM_DIRECTORY OWNER_PID CHROMEDRIVER [ARGUMENT...]`, in a session of its own. Its standard input is a
pipe from the owner: whatever arrives there, or the end of the file, ends the processes.

The work is done by a child of the process that was started. The child is out of reach of whoever ends the children of
its owner, as Ray does when a node dies. It is a subreaper: it inherits the orphans of Chrome and waits for them, which
otherwise fall to process 1, and in a container that may be a program that waits for nobody. Its parent waits for it.
"""

from __future__ import annotations

import ctypes
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
POLL_S = 0.2  # between two looks for children that have ended
PR_SET_CHILD_SUBREAPER = 36


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
            stat = (path / "stat").read_text(encoding="utf-8", errors="replace")
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


def main(directory: Path, owner: int, command: list[str]) -> None:
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, lambda *_: None)  # unlike SIG_IGN, this is not passed on to chromedriver
    if worker := os.fork():
        os.waitpid(worker, 0)
        return
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    environment = {**os.environ, DIRECTORY_VARIABLE: str(directory)}
    try:
        subprocess.Popen(command, stdin=subprocess.DEVNULL, start_new_session=True, env=environment)
    except OSError as error:
        sys.stderr.write(f"{command[0]}: {error.strerror}\n")
    else:
        _wait_for_end(owner)
    reap(directory)
    deadline = time.monotonic() + TIMEOUT_S
    while _has_children() and time.monotonic() < deadline:
        time.sleep(0.01)


def _wait_for_end(owner: int) -> None:
    """Return when the owner has ended or has written to its pipe, or when no child is left."""
    ends = [0]
    try:
        ends.append(os.pidfd_open(owner))  # a fork of the owner may keep the pipe open: watch the owner as well
    except ProcessLookupError:
        return
    except OSError:
        pass  # old kernels and some containers do not offer it
    while _has_children() and not select.select(ends, [], [], POLL_S)[0]:
        pass


def _has_children() -> bool:
    """Wait for the children that have ended; whether there are others."""
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return False
    return True


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
