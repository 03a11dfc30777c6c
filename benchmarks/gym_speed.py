"""Speed of the Gymnasium environments compared with the miniwob package's: python -m benchmarks.gym_speed [--json FILE]

One scripted policy plays click-checkboxes-large correctly on all sides, including resets; the sides alternate in turns
of a few seconds within one run. A step is an action that reached a page; an autoreset of the vector environment does
not count. CPU time is that of this process and of all processes of the browser and its driver.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import click
import numpy as np
import psutil

from benchmarks.gym_equality import PackageEnv
from browser_farm.chrome import reaper
from browser_farm.farm import ChromeFarm
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector
from giirl_core.files import writable, write_json

TASK = "click-checkboxes-large"
ENVS = 8
FIRST_SEED = 1 << 30  # far from the seeds used elsewhere
CLICK = 8  # action type CLICK_ELEMENT of the package
Turn = Callable[[float], tuple[int, int, float]]  # seconds to play -> steps, successful episodes, seconds played


def action(utterance: str, elements: tuple[dict[str, Any], ...]) -> dict[str, Any]:
    """Click the first unchecked checkbox that the instruction names, or else Submit."""
    wanted = set(utterance.removeprefix("Select ").removesuffix(" and click Submit.").split(", "))
    for box, label in itertools.pairwise(elements):
        if box["tag"] == "input_checkbox" and label["text"] in wanted and not box["value"]:
            return {"action_type": CLICK, "ref": box["ref"]}
    return {"action_type": CLICK, "ref": next(element["ref"] for element in elements if element["tag"] == "button")}


def single_env(env: Any, *, screenshots: bool) -> Turn:
    """Turns of an environment with one page."""
    seeds = iter(range(FIRST_SEED, 2 * FIRST_SEED))

    def play(seconds: float) -> tuple[int, int, float]:
        steps = successes = 0
        start = time.perf_counter()
        while time.perf_counter() - start < seconds:
            observation, _ = env.reset(seed=next(seeds), options={"record_screenshots": screenshots})
            done = False
            while not done:
                observation, _, done, _, info = env.step(action(observation["utterance"], observation["dom_elements"]))
                steps += 1
            successes += info["raw_reward"] == 1
        return steps, successes, time.perf_counter() - start

    return play


def vector_env(envs: MiniWoBVector) -> Turn:
    """Turns of a vector environment."""
    observations, _ = envs.reset(seed=FIRST_SEED)

    def play(seconds: float) -> tuple[int, int, float]:
        nonlocal observations
        steps = successes = 0
        start = time.perf_counter()
        while time.perf_counter() - start < seconds:
            pages = list(zip(observations["utterance"], observations["dom_elements"], strict=True))
            observations, rewards, _, _, _ = envs.step([action(*page) if page[1] else None for page in pages])
            steps += sum(bool(page[1]) for page in pages)
            successes += int(np.sum(rewards == 1))
        return steps, successes, time.perf_counter() - start

    return play


def cpu_s(pids: Iterable[int]) -> float:
    """CPU seconds so far of these processes and of our own."""
    used = time.process_time()
    for pid in pids:
        with contextlib.suppress(psutil.NoSuchProcess):
            times = psutil.Process(pid).cpu_times()
            used += times.user + times.system
    return used


def compare(sides: Mapping[str, tuple[Turn, set[int]]], rounds: int, seconds: float) -> dict[str, Any]:
    """The totals of each side, and the ratio of its speed to the package's: the median over rounds."""
    rates: dict[str, list[float]] = {name: [] for name in sides}
    total = {name: np.zeros(4) for name in sides}
    for play, _ in sides.values():
        play(1.0)  # warm-up: compile, fill caches, lay out
    for _ in range(rounds):
        for name, (play, pids) in sides.items():
            before = cpu_s(pids)
            steps, successes, took = play(seconds)
            rates[name].append(steps / took)
            total[name] += (steps, successes, took, cpu_s(pids) - before)
    package = np.array(rates["miniwob"])
    return {
        name: {
            "steps": int(total[name][0]),
            "episodes_won": int(total[name][1]),
            "steps_per_s": round(float(total[name][0] / total[name][2]), 1),
            "cpu_ms_per_step": round(1e3 * float(total[name][3] / total[name][0]), 2),
            "ratio_miniwob": round(float(np.median(np.array(rates[name]) / package)), 1),
        }
        for name in sides
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--json", type=writable)
    arguments = parser.parse_args()
    load = os.getloadavg()
    package, env, envs = PackageEnv(), MiniWoB(TASK), MiniWoBVector(TASK, ENVS)
    try:
        theirs = package.switch_task(TASK)
        theirs.instance.refresh_freq = 0  # the package's default: the page is loaded once
        theirs.instance.driver.get(theirs.instance.url)
        driver = psutil.Process(theirs.instance.driver.service.process.pid)
        browser = {driver.pid, *(child.pid for child in driver.children(recursive=True))}
        assert isinstance(env._farm, ChromeFarm)
        assert isinstance(envs._farm, ChromeFarm)
        sides = compare(
            {
                "miniwob": (single_env(theirs, screenshots=True), browser),
                "miniwob_no_screenshot": (single_env(theirs, screenshots=False), browser),
                "single": (single_env(env, screenshots=False), reaper.processes(Path(env._farm.chrome_directory))),
                f"vector_{ENVS}": (vector_env(envs), reaper.processes(Path(envs._farm.chrome_directory))),
            },
            arguments.rounds,
            arguments.seconds,
        )
    finally:
        package.env.close()
        env.close()
        envs.close()
    result = {"task": TASK, "sides": sides, "load_before": load, "load_after": os.getloadavg()}
    if arguments.json:
        write_json(arguments.json, result)
    click.echo(json.dumps(result, indent=2))


if __name__ == "__main__":
    main()
