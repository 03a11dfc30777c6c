"""A run that is killed at random moments, and the commands that go on with it.

python -m tests.faults.kills FOLDER KILLS SEED kills `giirl train` so often, starts it again each time with the same
command or with the one that its message names, and writes to FOLDER/result.json the parameters of the runs that
came to their end, those of a run that nobody killed, and every command that neither went on nor was killed.

A moment is a file operation in the run's folder (one of its calls of open, rename, mkdir, remove), counted by an audit
hook of Python, or a moment in time between two of them. Each command is a process forked from this one, which has
loaded the libraries once. The browser is the fake one.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import os
import random
import shutil
import signal
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from giirl.cli.main import main as giirl
from learner.checkpoint import latest_checkpoint
from tests.giirl.small import SETTINGS

START: tuple[str, ...] = ("train", *SETTINGS, "evaluate.episodes=1", "evaluate.random_episodes=1", "run=out")
DEADLINE_S = 60.0  # of a command
WRITES = ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir")


@dataclass
class Tally:
    """What happened so far."""

    straight: str = ""  # SHA-256 of the parameters of the run that nobody killed
    ended: list[str] = field(default_factory=list)  # of those that were killed and came to their end
    kills: int = 0
    stuck: list[str] = field(default_factory=list)  # commands that failed, with the message
    lost: list[str] = field(default_factory=list)  # kills after which an older checkpoint was the latest, or none
    step: int = 0  # of the latest checkpoint of the run that goes on


def main() -> None:
    folder, kills, seed = Path(sys.argv[1]).absolute(), int(sys.argv[2]), int(sys.argv[3])
    os.chdir(folder)
    for module in ("giirl.run.api", "giirl.run.train"):  # before the first fork
        importlib.import_module(module)
    moments, tally = random.Random(seed), Tally()
    operations, seconds = _measure(tally)
    while tally.kills < kills:
        command, status = START, _killed_at(START, moments, operations, seconds)
        while status == -signal.SIGKILL:
            tally.kills += 1
            command = _way_on(tally)
            status = _killed_at(command, moments, operations, seconds) if tally.kills < kills else _run(command)
        _end(command, status, tally)
    Path("result.json").write_text(json.dumps(tally.__dict__), encoding="utf-8")


def _measure(tally: Tally) -> tuple[int, float]:
    """How many file operations a run has, and how long it takes. Its parameters are those that all runs should have."""
    since_s = time.monotonic()
    _run(START, count_in=Path("operations"))
    tally.straight = json.loads(Path("out/result.json").read_text(encoding="utf-8"))["parameters_sha256"]
    shutil.rmtree("out")
    return int(Path("operations").read_text(encoding="utf-8")), time.monotonic() - since_s


def _killed_at(command: tuple[str, ...], moments: random.Random, operations: int, seconds: float) -> int:
    if moments.random() < 0.5:
        return _run(command, kill_at=moments.randrange(operations))
    return _run(command, kill_after_s=moments.uniform(0.0, seconds))


def _way_on(tally: Tally) -> tuple[str, ...]:
    """The command that goes on after a kill: the same, or the one that its message names."""
    checkpoints = Path("out/checkpoints")
    try:
        step = int(latest_checkpoint(checkpoints).name.split("-")[1])
    except ValueError as error:
        if tally.step or "holds no checkpoint" not in str(error):
            tally.lost.append(str(error))
        return START
    if step < tally.step:
        tally.lost.append(f"step {step} after {tally.step}")
    tally.step = step
    _run(START)
    message = Path("output").read_text(encoding="utf-8").splitlines()[-1]
    words = tuple(message.partition(": giirl train ")[2].split())
    if words != ("--resume", "out"):
        tally.stuck.append(f"{' '.join(START)}: {message}")
    return ("train", *words)


def _end(command: tuple[str, ...], status: int, tally: Tally) -> None:
    """Note the parameters of a run that came to its end, and clear the place for the next."""
    if status != 0:
        tally.stuck.append(f"{' '.join(command)}: {Path('output').read_text(encoding='utf-8')[-300:]}")
    else:
        tally.ended.append(json.loads(Path("out/result.json").read_text(encoding="utf-8"))["parameters_sha256"])
    shutil.rmtree("out")
    tally.step = 0


def _run(
    command: tuple[str, ...], *, kill_at: int = -1, kill_after_s: float = 0.0, count_in: Path | None = None
) -> int:
    """Run a command in a forked process; returns its exit status, or minus the signal that ended it."""
    pid = os.fork()
    if pid == 0:
        os._exit(_child(command, kill_at, count_in))
    deadline_s = time.monotonic() + (kill_after_s or DEADLINE_S)
    while not (ended := os.waitpid(pid, os.WNOHANG))[0]:
        if time.monotonic() > deadline_s:
            os.kill(pid, signal.SIGKILL)
        time.sleep(0.002)
    return os.waitstatus_to_exitcode(ended[1])


def _child(command: tuple[str, ...], kill_at: int, count_in: Path | None) -> int:
    operations, status = 0, 0
    home = str(Path("out").absolute())

    def count(event: str, details: tuple[object, ...]) -> None:
        nonlocal operations
        if event in WRITES and str(Path(os.fsdecode(str(details[0]))).absolute()).startswith(home):
            if operations == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
            operations += 1

    sys.addaudithook(count)
    sys.argv = ["giirl", *command]
    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output):
        try:
            giirl()
        except SystemExit as ended:
            status = int(ended.code or 0)
    Path("output").write_text(output.getvalue(), encoding="utf-8")
    if count_in is not None:
        count_in.write_text(str(operations), encoding="utf-8")
    return status


if __name__ == "__main__":
    main()
