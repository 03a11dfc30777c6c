"""The numbers of a study: a record of each finished run, and a summary of each variant over its seeds."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from statistics import fmean, median
from typing import Any

import numpy as np

from giirl.run.folder import RunFolder
from giirl.statistics import STREAK, Score
from giirl.studies.runner import REWARD_EVAL, TRANSFER, Planned
from giirl_core.config_file import changed
from giirl_core.telemetry.version import VERSION

LEVELS = (0.95, 0.99)  # success of STREAK episodes in a row
MAX_POINTS = 60  # of a learning curve in a record
BOOTSTRAP = 4_000  # samples


def record(run: Planned, *, evaluates_reward: bool = False) -> dict[str, Any]:
    """The result and the learning curve of a finished run; with `evaluates_reward` also the measures of its reward."""
    folder = RunFolder(run.folder)
    points = folder.points()
    result: dict[str, Any] = json.loads(folder.result.read_bytes())
    if run.variant.transfer_tasks:
        result["tasks"] |= json.loads((folder.path / TRANSFER).read_bytes())
    measures = folder.path / REWARD_EVAL
    return {
        "variant": run.variant.name,
        "giirl": VERSION,
        "settings": [one for one in changed(run.config) if not one.startswith("reward_from=")],
        **({"reward_of": run.variant.reward_of} if run.variant.reward_of else {}),
        **result,
        **(json.loads(measures.read_bytes()) if evaluates_reward and measures.exists() else {}),
        "episodes_to": {f"{level:g}": _first_reached(points, level, "episodes") for level in LEVELS},
        "env_steps_to": {f"{level:g}": _first_reached(points, level, "env_steps") for level in LEVELS},
        "curve": _thinned(points),
    }


def summary(name: str, runs: list[dict[str, Any]], *, left_out: Sequence[str] = ()) -> dict[str, Any]:
    """The result of a study: numbers of each variant, then all records.

    The numbers of a study of one variant are also at the top; those of a part, without the variants `left_out`, are
    not. Intervals are over pages, given these seeds; `worst_seed` is the success of the worst seed.
    """
    variants: dict[str, dict[str, Any]] = {}
    for variant in dict.fromkeys(run["variant"] for run in runs):
        variants[variant] = _variant([run for run in runs if run["variant"] == variant])
    head: dict[str, Any] = {"variants_left_out": list(left_out)} if left_out else {}
    if len(variants) == 1 and not left_out:
        head = {
            "tasks": variants[runs[0]["variant"]]["tasks"],
            "seconds": max(run["seconds"] for run in runs),
            "env_steps": max(run["env_steps"] for run in runs),
            "demonstrations": runs[0]["demonstrations"],
        }
    return {"study": name, **head, "variants": variants, "runs": runs}


def pooled(records: Sequence[dict[str, Any]], group: str = "") -> dict[str, dict[str, Any]]:
    """Success of each task over the pages of all seeds, with its Wilson interval.

    `group` is a part of the pages: "trained_goals" or "held_out_goals".
    """
    tasks: dict[str, dict[str, Any]] = {}
    for task in records[0]["tasks"]:
        rows = [record["tasks"][task] for record in records]
        parts = [row[group] for row in rows] if group else rows
        score = sum((_score(part["episodes"], part["success"]) for part in parts), Score(episodes=0, successes=0))
        random = sum((_score(r["random_episodes"], r["random"]) for r in rows), Score(episodes=0, successes=0))
        tasks[task] = {
            **score.row(digits=5),
            "missing": sum(row.get("missing", 0) for row in rows),
            "success": None if score.success is None else round(score.success, 5),
            "random": None if random.success is None else round(random.success, 5),
            "random_episodes": random.episodes,
            "worst_seed": min((part["success"] for part in parts if part["success"] is not None), default=None),
        }
    return tasks


def mean_with_interval(records: Sequence[dict[str, Any]], tasks: Sequence[str]) -> dict[str, float | None]:
    """The mean success over tasks and seeds, and its 95 % interval.

    The interval is a bootstrap over seeds, and over the pages of each task given the seed. A task of which a seed could
    play no page is left out; None if that leaves no task.
    """
    tasks = [task for task in tasks if all(record["tasks"][task]["episodes"] for record in records)]
    if not tasks:
        return dict.fromkeys(("mean", "low", "high"))
    success = np.array([[record["tasks"][task]["success"] for task in tasks] for record in records])
    pages = np.array([[record["tasks"][task]["episodes"] for task in tasks] for record in records])
    rng = np.random.default_rng(0)
    seeds = rng.integers(len(records), size=(BOOTSTRAP, len(records)))
    means = (rng.binomial(pages[seeds], success[seeds]) / pages[seeds]).mean(axis=(1, 2))
    low, high = np.quantile(means, (0.025, 0.975))
    return {"mean": round(float(success.mean()), 4), "low": round(float(low), 4), "high": round(float(high), 4)}


def _variant(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The numbers of one variant, from the records of its seeds."""
    tasks = pooled(runs)
    found: dict[str, Any] = {"tasks": tasks, "seeds": [run["seed"] for run in runs]}
    found["all_tasks"] = mean_with_interval(runs, tuple(tasks))
    for unit in ("episodes_to", "env_steps_to"):
        found[unit] = _median_reached([run[unit] for run in runs])
    found["lowest_last_third"] = {task: _lowest(runs, task) for task in tasks}
    if swaps := [run["goal_swap"] for run in runs if "goal_swap" in run]:
        found["goal_swap"] = {
            name: min(swap[name] for swap in swaps) for name in ("own_goal_top1", "swapped_goal_top1")
        }
    if measures := [run["sensitivity"] for run in runs if "sensitivity" in run]:
        found["sensitivity"] = {task: _sensitivity([measure[task] for measure in measures]) for task in measures[0]}
    for group in ("trained_goals", "held_out_goals"):
        if all(group in row for run in runs for row in run["tasks"].values()):
            found[group] = pooled(runs, group)
    return found


def _median_reached(found: Sequence[dict[str, dict[str, int | None]]]) -> dict[str, dict[str, dict[str, Any]]]:
    """For each level and task, how many seeds reached it, and the median episode or step at which they did."""
    reached: dict[str, dict[str, dict[str, Any]]] = {}
    for level, tasks in found[0].items():
        for task in tasks:
            when = [at for one in found if (at := one[level].get(task)) is not None]
            reached.setdefault(level, {})[task] = {"seeds": len(when), "median": median(when) if when else None}
    return reached


def _lowest(runs: Sequence[dict[str, Any]], task: str) -> float | None:
    """Of all seeds; None if every run was too short."""
    return min((low for run in runs if (low := run["lowest_last_third"].get(task)) is not None), default=None)


def _sensitivity(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """The AUC of the worst seed and the mean of its control; for trained and held-out goals apart where there are."""
    found = {"auc": min(row["auc"] for row in rows), "shuffled": fmean(row["shuffled"] for row in rows)}
    for group in ("trained_goals", "held_out_goals"):
        if all(group in row for row in rows):
            found[group] = min(row[group]["auc"] for row in rows)
    return {name: round(value, 4) for name, value in found.items()}


def _recent_success(points: Sequence[dict[str, Any]]) -> list[dict[str, float | None]]:
    """At every point of a curve, the success of the last STREAK episodes of each task; None while there are fewer."""
    last: dict[str, deque[int]] = {}
    found = []
    for point in points:
        for task, outcomes in point["outcomes"].items():
            last.setdefault(task, deque(maxlen=STREAK)).extend(outcomes)
        found.append({task: sum(some) / STREAK if len(some) == STREAK else None for task, some in last.items()})
    return found


def _first_reached(points: Sequence[dict[str, Any]], level: float, unit: str) -> dict[str, int | None]:
    """For each task, the episodes or steps of all tasks until STREAK of its episodes in a row had success `level`."""
    reached: dict[str, int | None] = {}
    for point, recent in zip(points, _recent_success(points), strict=True):
        for task, success in recent.items():
            if reached.setdefault(task, None) is None and success is not None and success >= level:
                reached[task] = point[unit]
    return reached


def _thinned(points: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """At most MAX_POINTS points of the curve, evenly spaced, the last one included."""
    every = max(1, -(-len(points) // MAX_POINTS))
    return [
        {"env_steps": point["env_steps"], "episodes": point["episodes"], "success": recent}
        for number, (point, recent) in enumerate(zip(points, _recent_success(points), strict=True), start=1)
        if number % every == 0 or number == len(points)
    ]


def _score(episodes: int, success: float | None) -> Score:
    return Score(episodes=episodes, successes=round(episodes * (success or 0.0)))
