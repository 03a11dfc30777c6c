"""Times the Gymnasium environments beside the miniwob package's: python -m benchmarks.gym_speed [--json FILE]

One policy plays click-checkboxes-large correctly on all sides, from observation to action, resets included; the sides
take turns of a few seconds in one run. Steps are actions that reached a page; a restart of the vector environment is
none. CPU time is that of this process and of every process of the browser and its driver.
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

from benchmarks.gym_equality import Reference
from browser_farm.chrome import reaper
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector
from giirl_core.files import write_json

TASK = "click-checkboxes-large"
PLACES = 8
FIRST_SEED = 1 << 30  # far from those that anything is learned on
CLICK = 8  # CLICK_ELEMENT among the package's action types
Turn = Callable[[float], tuple[int, int, float]]  # seconds to play -> steps, episodes that paid in full, seconds


def action(utterance: str, elements: tuple[dict[str, Any], ...]) -> dict[str, Any]:
    """Tick the first box that the instruction names and that is not yet ticked, else submit."""
    wanted = set(utterance.removeprefix("Select ").removesuffix(" and click Submit.").split(", "))
    for box, words in itertools.pairwise(elements):
        if box["tag"] == "input_checkbox" and words["text"] in wanted and not box["value"]:
            return {"action_type": CLICK, "ref": box["ref"]}
    return {"action_type": CLICK, "ref": next(each["ref"] for each in elements if each["tag"] == "button")}


def one(env: Any, *, screenshots: bool) -> Turn:
    """Turns of an environment that shows one page."""
    seeds = iter(range(FIRST_SEED, 2 * FIRST_SEED))

    def play(seconds: float) -> tuple[int, int, float]:
        steps = won = 0
        since = time.perf_counter()
        while time.perf_counter() - since < seconds:
            observed, _ = env.reset(seed=next(seeds), options={"record_screenshots": screenshots})
            done = False
            while not done:
                observed, _, done, _, info = env.step(action(observed["utterance"], observed["dom_elements"]))
                steps += 1
            won += info["raw_reward"] == 1
        return steps, won, time.perf_counter() - since

    return play


def many(envs: MiniWoBVector) -> Turn:
    """Turns of a vector environment."""
    observed, _ = envs.reset(seed=FIRST_SEED)

    def play(seconds: float) -> tuple[int, int, float]:
        nonlocal observed
        steps = won = 0
        since = time.perf_counter()
        while time.perf_counter() - since < seconds:
            shown = list(zip(observed["utterance"], observed["dom_elements"], strict=True))
            observed, rewards, _, _, _ = envs.step([action(*page) if page[1] else None for page in shown])
            steps += sum(bool(page[1]) for page in shown)
            won += int(np.sum(rewards == 1))
        return steps, won, time.perf_counter() - since

    return play


def cpu_s(pids: Iterable[int]) -> float:
    """CPU time of these processes so far, and of our own."""
    used = time.process_time()
    for pid in pids:
        with contextlib.suppress(psutil.NoSuchProcess):
            times = psutil.Process(pid).cpu_times()
            used += times.user + times.system
    return used


def race(sides: Mapping[str, tuple[Turn, set[int]]], rounds: int, seconds: float) -> dict[str, Any]:
    """What each side did, and its steps per second beside the package's in the same round (the median over rounds)."""
    rates: dict[str, list[float]] = {name: [] for name in sides}
    total = {name: np.zeros(4) for name in sides}
    for play, _ in sides.values():
        play(1.0)  # compiled, cached and laid out once
    for _ in range(rounds):
        for name, (play, pids) in sides.items():
            before = cpu_s(pids)
            steps, won, took = play(seconds)
            rates[name].append(steps / took)
            total[name] += (steps, won, took, cpu_s(pids) - before)
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
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    load = os.getloadavg()
    reference, env, envs = Reference(), MiniWoB(TASK), MiniWoBVector(TASK, PLACES)
    try:
        theirs = reference.show(TASK)
        theirs.instance.refresh_freq = 0  # as it comes: the page is loaded once
        theirs.instance.driver.get(theirs.instance.url)
        driver = psutil.Process(theirs.instance.driver.service.process.pid)
        browser = {driver.pid, *(child.pid for child in driver.children(recursive=True))}
        sides = race(
            {
                "miniwob": (one(theirs, screenshots=True), browser),
                "miniwob_no_screenshot": (one(theirs, screenshots=False), browser),
                "single": (one(env, screenshots=False), reaper.processes(Path(env._farm.chrome_directory))),
                f"vector_{PLACES}": (many(envs), reaper.processes(Path(envs._farm.chrome_directory))),
            },
            asked.rounds,
            asked.seconds,
        )
    finally:
        reference.env.close()
        env.close()
        envs.close()
    result = {"task": TASK, "sides": sides, "load_before": load, "load_after": os.getloadavg()}
    click.echo(json.dumps(result, indent=1))
    if asked.json:
        write_json(asked.json, result)


if __name__ == "__main__":
    main()
