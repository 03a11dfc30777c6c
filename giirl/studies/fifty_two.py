"""The head of the study of fifty-two tasks: one policy and one reward, beside cloning and published results."""

from __future__ import annotations

import csv
import importlib.resources
from typing import Any

from giirl.studies.summary import mean_with_interval

# Success of people and CC-Net (Humphreys et al. 2022, 2.4 million demonstrations and the true reward),
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


def fifty_two(result: dict[str, Any], variant: str, cloning: str) -> dict[str, Any]:
    """The head of the study's JSON: every task of `variant` with published results, and means over the tasks.

    `result` is that of `giirl.studies.summary.summary`. A task of which no page could be played is in no mean.
    """
    rows = result["variants"][variant]["tasks"]
    records = [record for record in result["runs"] if record["variant"] == variant]
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
        **result["variants"][variant]["all_tasks"],
        "mean_wge_48": mean_with_interval(records, wge)["mean"],
        "tasks_at_human": sum(row["episodes"] > 0 and row["success"] >= row["human"] for row in tasks.values()),
        "cloning_mean": result["variants"][cloning]["all_tasks"]["mean"],
        "seeds": result["variants"][variant]["seeds"],
        "seconds": max(record["seconds"] for record in records),
        "env_steps": max(record["env_steps"] for record in records),
    }
