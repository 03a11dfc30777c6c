"""`giirl stop`: ask a run to save and end, through a file in its folder, which works from any machine that has it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from giirl.run.folder import RunFolder
from giirl_core.files import is_locked

POLL_S = 0.3


@contextmanager
def stop_requests(folder: RunFolder) -> Iterator[None]:
    """In this block, `giirl stop` sends SIGTERM to this process. Earlier requests are forgotten."""
    request = _request(folder)
    request.unlink(missing_ok=True)
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(POLL_S):
            if request.exists():
                request.unlink(missing_ok=True)
                os.kill(os.getpid(), signal.SIGTERM)
                return

    thread = threading.Thread(target=watch, name="stop-requests", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def stop_run(path: Path, timeout_s: float) -> str:
    """Ask a run to save and end, and wait until it has; returns a line for the user.

    ValueError if it is not running, RuntimeError if it still runs after `timeout_s`.
    """
    folder, _ = RunFolder.open(path)
    if not is_locked(path):
        raise ValueError(f"no process runs {path}; to remove what it left: giirl clean {path}")
    folder.write(_request(folder), "")
    deadline_s = time.monotonic() + timeout_s
    while is_locked(path):
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"{path} still runs {timeout_s:.0f} s after it was asked to stop: kill its process")
        time.sleep(POLL_S)
    if folder.result.is_file():
        return f"{path} has ended with a result"
    return f"{path} is stopped; to resume: giirl train --resume {path}"


def _request(folder: RunFolder) -> Path:
    return folder.path / "stop"
