"""Throughput of a complete training run in Chrome, compared with the browser farm alone on the same tasks."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import psutil

from actors.agents import RandomAgent
from actors.browser import open_browser
from actors.rollouts import play
from actors.schedule import Schedule
from benchmarks.pages import load_fixture
from giirl_core.config import DEFAULT_TASKS, ActorConfig, Config
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Episode, Outcome, Purpose
from giirl_core.wire.messages import write_episodes

MIX = tuple(sorted({t.task for t in load_fixture()[0]}))  # the tasks with demonstrations in the fixture
CASES = {"four": (DEFAULT_TASKS, 32), "mix": (MIX, len(MIX))}  # tasks, and episodes per iteration
ITERATIONS = {"four": 200, "mix": 40}
WARM_UP = 0.25  # fraction of the iterations that are not measured, while processes start and pages open
BARE_S = 20.0  # duration of the measurement without training
POLL_S = 1.0
TIMEOUT_S = 1800.0  # of a training run


def measure(
    display: Display, *, actors: int = 1, tabs: int = 8, cases: tuple[str, ...] = ("four", "mix")
) -> dict[str, Any]:
    """Measure training and the farm alone for each case; returns the JSON of `giirl bench training`."""
    result: dict[str, Any] = {}
    for case in cases:
        with display.busy(f"training on {case}"):
            trained = _train(case, actors, tabs)
        with display.busy(f"the browser farm alone on {case}"):
            bare = _play_bare(case, tabs)
        result[case] = {**trained, "bare_steps_per_s": bare}
        result[case]["share_of_bare_farm"] = round(trained["steps_per_s"] / bare, 3)
    result["settings"] = {"actors": actors, "tabs": tabs, "cores": os.cpu_count()}
    return result


def _train(case: str, actors: int, tabs: int) -> dict[str, Any]:
    """A run in a separate process: rates after the warm-up, and the CPU share of each kind of process.

    RuntimeError if the run fails or does not end within TIMEOUT_S.
    """
    tasks, batch = CASES[case]
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        settings = [f"tasks={json.dumps(list(tasks))}", f"rollout_batch={batch}", f"iterations={ITERATIONS[case]}"]
        settings += [f"run={run}", "runtime=local", f"actors.count={actors}", f"actors.tabs={tabs}"]
        settings += ["demos.source=file", f"demos.path={_demonstrations(Path(folder), tasks)}", "step_limit=10"]
        settings += ["evaluate.episodes=1", "evaluate.random_episodes=1", f"checkpoint_every={ITERATIONS[case]}"]
        command = [sys.executable, "-m", "giirl", "train", *settings]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        cpu = _watch(process, run / "curve.jsonl")
        if process.wait(TIMEOUT_S):
            assert process.stderr is not None
            raise RuntimeError(f"the training run failed: {process.stderr.read().strip().splitlines()[-1:]}")
        points = [json.loads(line) for line in (run / "curve.jsonl").read_text(encoding="utf-8").splitlines()]
        flow = json.loads((run / "result.json").read_bytes())["flow"]
    measured = points[int(WARM_UP * len(points)) :]
    seconds = measured[-1]["seconds"] - measured[0]["seconds"]
    total = sum(cpu.values()) or 1.0
    return {
        "steps_per_s": round((measured[-1]["env_steps"] - measured[0]["env_steps"]) / seconds, 1),
        "episodes_per_s": round((measured[-1]["episodes"] - measured[0]["episodes"]) / seconds, 1),
        "learner_waits": round(statistics.fmean(point["flow"]["learner_waits"] for point in measured), 3),
        "actors_idle": round(statistics.fmean(point["flow"]["actors_idle"] for point in measured), 3),
        "lag": flow["lag"],
        "stale_share": flow["stale"],
        "service_reward_share": flow["service_reward_share"],
        "cpu_share": {kind: round(used / total, 3) for kind, used in sorted(cpu.items())},
    }


def _demonstrations(folder: Path, tasks: tuple[str, ...]) -> Path:
    """Write the fixture's demonstrations of `tasks` into a file; returns its path."""
    demonstrations = [t for t in load_fixture()[0] if t.task in tasks]
    path = folder / "demonstrations.giirl"
    write_episodes(path, [Episode(trajectory=t, outcome=Outcome(raw_reward=1.0, ended=True)) for t in demonstrations])
    return path


def _watch(process: subprocess.Popen[str], curve: Path) -> dict[str, float]:
    """CPU seconds of each kind of process, from the first point of `curve` to the end of the run."""
    used: dict[int, tuple[str, float, float]] = {}  # pid: kind, first and last CPU seconds
    since_s = time.monotonic()
    while process.poll() is None:
        if time.monotonic() - since_s > TIMEOUT_S:
            process.kill()
            raise RuntimeError(f"the training run did not end within {TIMEOUT_S:.0f} s")
        if curve.exists() and curve.stat().st_size:
            try:
                processes = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
            except psutil.Error:
                break
            for member in processes:
                try:
                    times, kind = member.cpu_times(), _kind(member, process.pid)
                except psutil.Error:
                    continue
                now = times.user + times.system
                first = used[member.pid][1] if member.pid in used else now
                used[member.pid] = (kind, first, now)
        time.sleep(POLL_S)
    cpu: dict[str, float] = {}
    for kind, first, last in used.values():
        cpu[kind] = cpu.get(kind, 0.0) + last - first
    return cpu


def _kind(process: psutil.Process, learner_pid: int) -> str:
    if process.pid == learner_pid:
        return "learner"
    command = " ".join(process.cmdline())
    for part, kind in (("ActorProcess", "actor"), ("RewardProcess", "reward_service"), ("chrom", "chrome")):
        if part in command:
            return kind
    return "other"


def _play_bare(case: str, tabs: int) -> float:
    """Environment steps per second of the random policy in one browser with `tabs` tabs, without a learner."""
    tasks, _ = CASES[case]
    config, metrics = Config(tasks=tasks, actors=ActorConfig(tabs=tabs)), Metrics()
    browser = open_browser(config, metrics)
    try:
        schedule = Schedule(tasks, browser.tabs, purpose=Purpose.INSPECT, run_seed=0)
        steps, begin_s = 0, 0.0
        for ended in play(browser, RandomAgent(), schedule, step_limit=config.step_limit, metrics=metrics):
            steps += sum(len(episode.trajectory) for episode in ended)
            if not begin_s and steps:
                begin_s, steps = time.monotonic(), 0
            elif begin_s and time.monotonic() - begin_s > BARE_S:
                break
    finally:
        browser.close()
    return round(steps / (time.monotonic() - begin_s), 1)
