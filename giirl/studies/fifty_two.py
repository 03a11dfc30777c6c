"""The study of fifty-two tasks: one policy and one reward, compared with cloning and with published results."""

from __future__ import annotations

import csv
import importlib.resources
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Column, Table

from giirl.statistics import percent

# Success of people (Liu et al. 2018), CC-Net (Humphreys et al. 2022, 2.4 million demonstrations and the true reward),
# WGE (Liu et al. 2018, one policy per task, 10 demonstrations and the true reward) and HTML-T5-XL (Gur et al. 2024,
# 347,000 demonstrations). Tasks named -nodelay have the figures of the task with the delay.
_TABLE = (importlib.resources.files(__package__) / "published.csv").read_text(encoding="utf-8")
PUBLISHED = {
    row.pop("task"): {name: float(value) for name, value in row.items() if value}
    for row in csv.DictReader(_TABLE.splitlines())
}
TASKS = tuple(PUBLISHED)
# Recordings of these do not hold the answer: a colour, a drawing, a choice in a native list, a secret number.
SCRIPTED = ("click-color", "click-shape", "count-shape", "choose-list", "guess-number")
BOOTSTRAP = 4_000  # samples


def fifty_two(result: dict[str, Any], variant: str, cloning: str) -> dict[str, Any]:
    """The head of the study's JSON: every task of `variant` with published results, and means over the tasks.

    `result` is that of `giirl.studies.summary.summary`. A task of which no page could be played is in no mean.
    """
    rows, records = result["variants"][variant]["tasks"], _records(result, variant)
    from_people = "demos.source=recordings" in records[0]["settings"]
    tasks = {
        task: {
            **rows[task],
            **PUBLISHED[task],
            "source": "recordings" if from_people and task not in SCRIPTED else "scripted",
        }
        for task in TASKS
    }
    wge = [task for task in TASKS if "wge" in PUBLISHED[task]]
    return {
        "tasks": tasks,
        **mean_with_interval(records, TASKS),
        "mean_wge_48": mean_with_interval(records, wge)["mean"],
        "tasks_at_human": sum(row["episodes"] > 0 and row["success"] >= row["human"] for row in tasks.values()),
        "cloning_mean": mean_with_interval(_records(result, cloning), TASKS)["mean"],
        "seeds": result["variants"][variant]["seeds"],
        "seconds": max(record["seconds"] for record in records),
        "env_steps": max(record["env_steps"] for record in records),
    }


def mean_with_interval(records: Sequence[dict[str, Any]], tasks: Sequence[str]) -> dict[str, float]:
    """The mean success over tasks and seeds, and its 95 % interval.

    The interval is a bootstrap over seeds, and over the pages of each task given the seed. A task of which a seed could
    play no page is left out.
    """
    tasks = [task for task in tasks if all(record["tasks"][task]["episodes"] for record in records)]
    success = np.array([[record["tasks"][task]["success"] for task in tasks] for record in records])
    pages = np.array([[record["tasks"][task]["episodes"] for task in tasks] for record in records])
    rng = np.random.default_rng(0)
    seeds = rng.integers(len(records), size=(BOOTSTRAP, len(records)))
    means = (rng.binomial(pages[seeds], success[seeds]) / pages[seeds]).mean(axis=(1, 2))
    low, high = np.quantile(means, (0.025, 0.975))
    return {"mean": round(float(success.mean()), 4), "low": round(float(low), 4), "high": round(float(high), 4)}


def fifty_two_table(title: str, head: dict[str, Any], result: dict[str, Any]) -> Table:
    """A row for each task: all variants, the random baseline and what was published."""
    names = list(result["variants"])
    published = ("human", "cc_net", "wge", "html_t5")
    table = Table("task", *(Column(name, justify="right") for name in (*names, "random", *published)), title=title)
    for task, row in head["tasks"].items():
        own = [percent(result["variants"][name]["tasks"][task]["success"]) for name in names]
        table.add_row(task, *own, percent(row["random"]), *(percent(row.get(name)) for name in published))
    means = [mean_with_interval(_records(result, name), TASKS) for name in names]
    cells = [f"{percent(m['mean'])} ({percent(m['low'])} - {percent(m['high'])})" for m in means]
    random = percent(float(np.mean([row["random"] for row in head["tasks"].values() if row["random"] is not None])))
    others = [[row[name] for row in PUBLISHED.values() if name in row] for name in published]
    table.add_row("mean", *cells, random, *(percent(float(np.mean(values))) for values in others))
    return table


def _records(result: dict[str, Any], variant: str) -> list[dict[str, Any]]:
    return [record for record in result["runs"] if record["variant"] == variant]
