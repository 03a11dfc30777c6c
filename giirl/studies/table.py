"""The result of a study as a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

from rich.table import Column, Table

from giirl.run.evaluate import THESIS
from giirl.statistics import percent

WIDEST = 8  # more tasks than this are rows


def study_table(title: str, result: dict[str, Any]) -> Table:
    """Success of every variant with its interval over all seeds, then the random baseline and the thesis."""
    tasks = list(dict.fromkeys(task for found in result["variants"].values() for task in found["tasks"]))
    if len(tasks) > WIDEST:
        return task_table(title, tasks, result)
    table = Table("", Column("seeds", justify="right"), *(Column(task, justify="right") for task in tasks), title=title)
    for name, found in result["variants"].items():
        _add_variant(table, tasks, name, found)
    table.add_row("random", "", *(percent(_random(result["variants"], task)) for task in tasks))
    if set(tasks) & set(THESIS):
        table.add_row("thesis", "", *(f"{100 * THESIS[task]:.0f}" if task in THESIS else "-" for task in tasks))
    return table


def task_table(
    title: str,
    tasks: Sequence[str],
    result: dict[str, Any],
    published: Mapping[str, Mapping[str, float]] | None = None,
) -> Table:
    """A row for each task and their mean: all variants, the random baseline and, by task, what was published."""
    variants, published = result["variants"], published or {}
    sources = list(dict.fromkeys(source for row in published.values() for source in row))
    table = Table("task", *(Column(name, justify="right") for name in (*variants, "random", *sources)), title=title)
    random = {task: _random(variants, task) for task in tasks}
    for task in tasks:
        rows = [found["tasks"].get(task, {}) for found in variants.values()]
        others = [published.get(task, {}).get(source) for source in sources]
        table.add_row(task, *map(percent, (*(row.get("success") for row in rows), random[task], *others)))
    means = [found["all_tasks"] for found in variants.values()]
    cells = [f"{percent(m['mean'])} ({percent(m['low'])} - {percent(m['high'])})" for m in means]
    columns = [list(random.values()), *([row.get(source) for row in published.values()] for source in sources)]
    known = [[value for value in column if value is not None] for column in columns]
    table.add_row("mean", *cells, *(percent(fmean(values) if values else None) for values in known))
    return table


def _random(variants: Mapping[str, Any], task: str) -> float | None:
    """The random baseline of a task, from the first variant that has one."""
    rows = (found["tasks"].get(task, {}) for found in variants.values())
    return next((row["random"] for row in rows if row.get("random") is not None), None)


def _add_variant(table: Table, tasks: list[str], name: str, found: dict[str, Any]) -> None:
    cells = [_success(found["tasks"][task]) if task in found["tasks"] else "-" for task in tasks]
    table.add_row(name, str(len(found["seeds"])), *cells)
    lowest = [found["lowest_last_third"].get(task) for task in tasks]
    reached = found["env_steps_to"]["0.95"]
    table.add_row("  steps until 95 %, median", "", *(_steps(reached.get(task), found) for task in tasks))
    table.add_row("  lowest in the last third", "", *("-" if low is None else f"{low:.2f}" for low in lowest))
    if "goal_swap" in found:
        own, swapped = (found["goal_swap"][key] for key in ("own_goal_top1", "swapped_goal_top1"))
        table.add_row(f"  goal's button first: {own:.3f}, after a goal swap {swapped:.3f}")
    if sensitivity := found.get("sensitivity"):
        cells = [_auc(sensitivity[task]) if task in sensitivity else "-" for task in tasks]
        table.add_row("  goal sensitivity, AUC, worst seed", "", *cells)
    if "held_out_goals" in found:
        table.add_row("  held-out goals", "", *(_success(found["held_out_goals"][task]) for task in tasks))


def _success(row: dict[str, Any]) -> str:
    if row["success"] is None:
        return "-"
    worst = f", worst {100 * row['worst_seed']:.1f}" if row["worst_seed"] < row["success"] else ""
    return f"{100 * row['success']:.1f} ({100 * row['low']:.1f} - {100 * row['high']:.1f}{worst})"


def _steps(reached: dict[str, Any] | None, variant: dict[str, Any]) -> str:
    if not reached or not reached["seeds"]:
        return "-" if reached is None else "never"
    few = f" ({reached['seeds']} of {len(variant['seeds'])})" if reached["seeds"] < len(variant["seeds"]) else ""
    return f"{reached['median']:,.0f}{few}"


def _auc(row: dict[str, float]) -> str:
    held_out = f", held out {row['held_out_goals']:.3f}" if "held_out_goals" in row else ""
    return f"{row.get('trained_goals', row['auc']):.3f}{held_out} (shuffled {row['shuffled']:.2f})"
