"""How fast the farm is beside the miniwob package's environment, and what it weighs: `giirl bench farm`.

Both sides are played by the same scripted experts, in turns within one run, episodes whole and resets included. Time
is taken from the action handed in to the observation handed out as arrays; CPU over all processes of a side, our own
Python among them. Memory is PSS of the browser and its driver.
"""

from __future__ import annotations

import itertools
import os
import platform
import statistics
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from benchmarks.sides import FIRST_SEED, FarmSide, PackageSide, Played, pss_mb
from giirl_core.progress import Display, Job

TASKS = ("click-test", "click-button", "enter-text", "click-checkboxes-large", "email-inbox", "social-media-all")
TABS = 16  # what a step costs besides its pages, all tabs share
HEAVY = "click-checkboxes-large"  # what memory is measured on
SIDES = ("farm", "miniwob", "miniwob_no_screenshot")


def measure(
    display: Display, *, tasks: tuple[str, ...] = TASKS, rounds: int = 5, seconds: float = 2.0
) -> dict[str, Any]:
    """Everything, as the JSON says it."""
    seeds = itertools.count(FIRST_SEED)
    load_before = os.getloadavg()
    rows: dict[str, Any] = {}
    with display.job("rounds", rounds * len(tasks)) as job:
        farm = FarmSide(TABS)
        try:
            for task in tasks:
                rows[task], package_mb = _race(farm, task, rounds, seconds, seeds, job)
                if task == HEAVY:
                    memory = {"mb_per_env_miniwob": package_mb}
        finally:
            farm.close()
    if HEAVY in tasks:
        memory |= {f"mb_per_env_{tabs}_tabs": _weigh(tabs, seconds, seeds) for tabs in (8, 32)}
    return {
        "tasks": rows,
        "memory": {name: round(value, 1) for name, value in memory.items()} if HEAVY in tasks else {},
        "settings": {"rounds": rounds, "seconds": seconds, "tabs": TABS, "first_seed": FIRST_SEED},
        "machine": {
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "miniwob": version("miniwob"),
            "load_before": load_before,
            "load_after": os.getloadavg(),
        },
    }


def _race(
    farm: FarmSide, task: str, rounds: int, seconds: float, seeds: Iterator[int], job: Job
) -> tuple[dict[str, Any], float]:
    """One task: the sides take turns. The ratios are medians over rounds, so that a busy moment hits both sides."""
    sides: dict[str, FarmSide | PackageSide] = {"farm": farm}
    total = {name: Played() for name in SIDES}
    rates: dict[str, list[float]] = {name: [] for name in SIDES}
    try:
        for screenshots, name in ((True, "miniwob"), (False, "miniwob_no_screenshot")):
            sides[name] = PackageSide(task, screenshots=screenshots)
        for name in SIDES:
            sides[name].play(task, 1.0, seeds)  # compiled, cached and laid out once
        for _ in range(rounds):
            for name in SIDES:
                played = sides[name].play(task, seconds, seeds)
                total[name].add(played)
                rates[name].append(played.steps / played.wall_s)
            job.advance(1, task)
        package_mb = pss_mb(sides["miniwob"].pids())
    finally:
        for side in sides.values():
            if side is not farm:
                side.close()
    ours = total["farm"]

    def ratio(name: str) -> float:
        return statistics.median(a / b for a, b in zip(rates["farm"], rates[name], strict=True))

    return {
        "steps_per_s": round(ours.steps / ours.wall_s, 1),
        "cpu_ms_per_step": round(1000 * ours.cpu_s / ours.steps, 3),
        "steps_per_core_second": round(ours.steps / ours.cpu_s, 1),
        "ratio_miniwob": round(ratio("miniwob"), 1),
        "ratio_miniwob_no_screenshot": round(ratio("miniwob_no_screenshot"), 1),
        "sides": {
            name: {
                "steps": played.steps,
                "episodes": played.episodes,
                "successes": played.successes,
                "steps_per_s": round(played.steps / played.wall_s, 1),
                "cpu_ms_per_step": round(1000 * played.cpu_s / played.steps, 3),
            }
            for name, played in total.items()
        },
    }, package_mb


def _weigh(tabs: int, seconds: float, seeds: Iterator[int]) -> float:
    """MB per environment of a farm of so many tabs that has played for a while."""
    farm = FarmSide(tabs)
    try:
        farm.play(HEAVY, 3 * seconds, seeds)
        return pss_mb(farm.pids()) / tabs
    finally:
        farm.close()
