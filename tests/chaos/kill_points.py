"""Runs that kill themselves with SIGKILL at a chosen point and are resumed: do they end with the same parameters?

python -m tests.chaos.kill_points FOLDER serial|lock-step POINTS writes {"straight": HASH, "resumed": {POINT: HASH}} to
FOLDER/result.json. Each run is a process forked from this one, which has loaded the libraries once. The browser is the
fake one. In lock-step, actors and reward service are threads of the run, so that one signal ends all of them, as it
does when Ray runs on one machine; their sockets and messages are real.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import giirl.run.train as giirl_run
from giirl.run.workers import WorkersRuntime
from learner.checkpoint import latest_checkpoint
from tests.chaos.storm import start
from tests.giirl.small import run
from tests.thread_platform import ThreadPlatform

SETTINGS = {
    "serial": ("runtime=serial",),
    "lock-step": ("runtime=local", "stream.policy_lag=0", "stream.reward_lag=0", "actors.count=2", "stream.credits=2"),
}
FEW = ("iterations=6", "checkpoint_every=2", "keep_checkpoints=2", "evaluate.episodes=1", "evaluate.random_episodes=1")
# Functions that a run calls repeatedly; the run kills itself at the start of one of these calls.
KILL_POINTS: dict[str, tuple[Any, str]] = {
    "take": (giirl_run.Session, "take"),  # before it waits for rollouts
    "observe": (giirl_run.Session, "_observe"),  # between update and checkpoint
    "publish": (giirl_run.Session, "_update_targets"),  # after the processes got new weights
    "write": (Path, "write_text"),  # a file of a checkpoint, or a pointer
    "sync": (os, "fsync"),
    "rename": (Path, "rename"),  # of a finished checkpoint
    "point": (Path, "replace"),  # of the `latest` file
    "prune": (shutil, "rmtree"),
}


def points(count: int) -> list[str]:
    """`count` points from the last three quarters of a run, each as NAME-CALL."""
    calls = {"take": 6, "observe": 6, "publish": 6, "write": 18, "sync": 60, "rename": 4, "point": 12, "prune": 2}
    candidates = [f"{name}-{number}" for name, last in calls.items() for number in range(last // 4, last)]
    return [candidates[index * len(candidates) // count] for index in range(count)]


def main() -> None:
    folder, mode, count = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    if mode == "lock-step":
        giirl_run.open_runtime = _open_runtime  # type: ignore[assignment]
    hashes: dict[str, str] = {}
    _fork(lambda: _train(mode, folder / "straight"))
    for point in points(count):
        path = folder / point
        status = _fork(lambda path=path, point=point: _train_until_killed(mode, path, point))  # type: ignore[misc]
        if status == -signal.SIGKILL:
            _fork(lambda path=path: _resume(mode, path))  # type: ignore[misc]
        hashes[point] = _hash(path) if status == -signal.SIGKILL else f"not killed: {status}"
    result = {"straight": _hash(folder / "straight"), "resumed": hashes}
    (folder / "result.json").write_text(json.dumps(result))


def _fork(child: Callable[[], None]) -> int:
    """Run `child` in a forked process; returns its exit status, or minus the signal that ended it."""
    _, status = os.waitpid(start("run", child), 0)
    return os.waitstatus_to_exitcode(status)


def _train(mode: str, path: Path) -> None:
    result = run(path, *SETTINGS[mode], *FEW)
    (path / "result.json").write_text(json.dumps(result))


def _train_until_killed(mode: str, path: Path, point: str) -> None:
    name, _, number = point.partition("-")
    owner, function = KILL_POINTS[name]
    original, left = getattr(owner, function), int(number)

    def killing(*args: Any, **kwargs: Any) -> Any:
        nonlocal left
        left -= 1
        if left < 0 and (path / "checkpoints" / "latest").exists():
            os.kill(os.getpid(), signal.SIGKILL)
        return original(*args, **kwargs)

    setattr(owner, function, killing)
    _train(mode, path)


def _resume(mode: str, path: Path) -> None:
    result = run(path, *SETTINGS[mode], *FEW, resume=latest_checkpoint(path / "checkpoints"))
    (path / "result.json").write_text(json.dumps(result))


def _hash(path: Path) -> str:
    result = path / "result.json"
    digest: str = json.loads(result.read_text())["parameters_sha256"] if result.exists() else "no result"
    shutil.rmtree(path)
    return digest


def _open_runtime(settings: Any, folder: Any, metrics: Any, stop: Any, resume: Any, save: Any) -> WorkersRuntime:
    return WorkersRuntime(settings, folder, ThreadPlatform(), metrics, stop, resume, save)


if __name__ == "__main__":
    main()
