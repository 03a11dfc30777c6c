"""Time to learn with 1, 2, 4 and 8 actors, on pages that respond slowly."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from pathlib import Path
from statistics import fmean
from typing import Any

from giirl_core.progress import Display

STREAK = 50  # training episodes of a task
TASKS = ("click-button", "enter-text")
LEVEL = 0.95  # success of the last STREAK training episodes of every task
ITERATIONS = 400  # of a run that does not reach LEVEL earlier
POLL_S = 0.5
TIMEOUT_S = 1800.0  # of one run


def measure(
    display: Display, *, actors: tuple[int, ...] = (1, 2, 4, 8), delay_s: float = 0.2, seeds: int = 3
) -> dict[str, Any]:
    """Train with each number of actors and seed; returns the JSON of `giirl bench scaling`.

    Every step of a page takes at least `delay_s` seconds. The time begins with the first iteration, when all browsers
    are open, and ends when both tasks are at LEVEL. `share_of_linear` compares steps per second and time with those of
    the first number of actors.
    """
    found: dict[str, list[dict[str, Any]]] = {str(count): [] for count in actors}
    with display.job("runs", len(actors) * seeds) as job:
        for seed in range(seeds):
            for count in actors:
                found[str(count)].append(_run(count, delay_s, seed))
                job.advance(note=f"{count} actors: {found[str(count)][-1]['seconds']} s")
    means: dict[str, dict[str, float]] = {
        count: {name: round(fmean(run[name] for run in runs), 3) for name in runs[0]} for count, runs in found.items()
    }
    first = means[str(actors[0])]
    for name, row in means.items():
        more = int(name) / actors[0]
        row["share_of_linear"] = round(first["seconds"] / row["seconds"] / more, 3)
        row["steps_share_of_linear"] = round(row["steps_per_s"] / first["steps_per_s"] / more, 3)
    return {
        "actors": means,
        "seconds_by_seed": {count: [run["seconds"] for run in runs] for count, runs in found.items()},
        "settings": {"tasks": list(TASKS), "delay_s": delay_s, "seeds": seeds, "level": LEVEL, "streak": STREAK},
    }


def _run(actors: int, delay_s: float, seed: int) -> dict[str, Any]:
    """One run, ended when it reaches LEVEL. RuntimeError if it fails, or does not reach LEVEL."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        settings = [f"tasks={json.dumps(list(TASKS))}", f"iterations={ITERATIONS}", f"run={run}", f"seed={seed}"]
        settings += ["runtime=local", f"actors.count={actors}", f"actors.step_delay_s={delay_s}"]
        with (Path(folder) / "log").open("w+", encoding="utf-8") as log:
            command = [sys.executable, "-m", "giirl", "train", *settings]
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
            try:
                points = _until_learned(process, run / "curve.jsonl")
            finally:
                _end(process)
            if not points:
                log.seek(0)
                words = log.read().strip().splitlines()[-1:]
                raise RuntimeError(f"{actors} actors, seed {seed}: {LEVEL:.0%} was not reached: {words}")
    first, last = points[0], points[-1]
    seconds = last["seconds"] - first["seconds"]
    return {
        "seconds": round(seconds, 1),
        "iterations": last["step"],
        "steps_per_s": round((last["env_steps"] - first["env_steps"]) / seconds, 1),
        **{name: round(fmean(p["flow"][name] for p in points), 4) for name in ("learner_waits", "lag", "stale")},
    }


def _until_learned(process: subprocess.Popen[bytes], curve: Path) -> list[dict[str, Any]]:
    """The points of the curve up to the first one at LEVEL; none if the process ends before or takes too long."""
    since_s = time.monotonic()
    while process.poll() is None and time.monotonic() - since_s < TIMEOUT_S:
        lines = curve.read_text(encoding="utf-8").split("\n")[:-1] if curve.exists() else []
        points = [json.loads(line) for line in lines]
        recent = {task: deque[int](maxlen=STREAK) for task in TASKS}
        for index, point in enumerate(points):
            for task, outcomes in point["outcomes"].items():
                recent[task].extend(outcomes)
            if all(len(some) == STREAK and fmean(some) >= LEVEL for some in recent.values()):
                return points[: index + 1]
        time.sleep(POLL_S)
    return []


def _end(process: subprocess.Popen[bytes]) -> None:
    """Stop the run as Ctrl-C does, and kill it if that takes too long."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(60)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
