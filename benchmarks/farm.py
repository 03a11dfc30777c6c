"""Speed and memory of the browser farm compared with the miniwob package's environment: `giirl bench farm`.

The same scripted experts play both sides in alternating turns within one run; episodes are complete and resets count.
Wall time is measured from passing an action to receiving the observation as arrays. CPU time is the sum over all
processes of a side, including our own Python. Memory is the PSS of the browser and its driver.
"""

from __future__ import annotations

import itertools
import os
import platform
import statistics
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from benchmarks.sides import FIRST_SEED, FarmSide, PackageSide, PlayStats, pss_mb
from giirl_core.progress import Display, Job

TASKS = ("click-test", "click-button", "enter-text", "click-checkboxes-large", "email-inbox", "social-media-all")
TABS = 16  # tabs share the fixed cost of a step
MEMORY_TASK = "click-checkboxes-large"  # memory is measured on this task
SIDES = ("farm", "miniwob", "miniwob_no_screenshot")


def measure(
    display: Display, *, tasks: tuple[str, ...] = TASKS, rounds: int = 5, seconds: float = 2.0
) -> dict[str, Any]:
    """Run the benchmark: `rounds` turns of `seconds` for each side and task. Returns the JSON result."""
    seeds = itertools.count(FIRST_SEED)
    load_before = os.getloadavg()
    rows: dict[str, Any] = {}
    with display.job("rounds", rounds * len(tasks)) as job:
        farm = FarmSide(TABS)
        try:
            for task in tasks:
                rows[task], package_mb = _compare(farm, task, rounds, seconds, seeds, job)
                if task == MEMORY_TASK:
                    memory = {"mb_per_env_miniwob": package_mb}
        finally:
            farm.close()
    if MEMORY_TASK in tasks:
        memory |= {f"mb_per_env_{tabs}_tabs": _memory_per_tab(tabs, seconds, seeds) for tabs in (8, 32)}
    return {
        "tasks": rows,
        "memory": {name: round(value, 1) for name, value in memory.items()} if MEMORY_TASK in tasks else {},
        "settings": {"rounds": rounds, "seconds": seconds, "tabs": TABS, "first_seed": FIRST_SEED},
        "machine": {
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "miniwob": version("miniwob"),
            "load_before": load_before,
            "load_after": os.getloadavg(),
        },
    }


def _compare(
    farm: FarmSide, task: str, rounds: int, seconds: float, seeds: Iterator[int], job: Job
) -> tuple[dict[str, Any], float]:
    """One task, with alternating turns. Ratios are medians over rounds, so that a load peak affects all sides alike.

    Returns the result of the task, and the memory of the package's environment in MB.
    """
    sides: dict[str, FarmSide | PackageSide] = {"farm": farm}
    total = {name: PlayStats() for name in SIDES}
    rates: dict[str, list[float]] = {name: [] for name in SIDES}
    try:
        for screenshots, name in ((True, "miniwob"), (False, "miniwob_no_screenshot")):
            sides[name] = PackageSide(task, screenshots=screenshots)
        for name in SIDES:
            sides[name].play(task, 1.0, seeds)  # warm-up: compile, fill caches, lay out
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
    farm_total = total["farm"]

    def ratio(name: str) -> float:
        return statistics.median(a / b for a, b in zip(rates["farm"], rates[name], strict=True))

    return {
        "steps_per_s": round(farm_total.steps / farm_total.wall_s, 1),
        "cpu_ms_per_step": round(1000 * farm_total.cpu_s / farm_total.steps, 3),
        "steps_per_core_second": round(farm_total.steps / farm_total.cpu_s, 1),
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


def _memory_per_tab(tabs: int, seconds: float, seeds: Iterator[int]) -> float:
    """Memory per tab in MB, of a farm that has played for a while."""
    farm = FarmSide(tabs)
    try:
        farm.play(MEMORY_TASK, 3 * seconds, seeds)
        return pss_mb(farm.pids()) / tabs
    finally:
        farm.close()
