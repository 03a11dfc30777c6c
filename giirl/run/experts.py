"""Success of the scripted experts on many pages of each task, with the actions that they took."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from actors.agents import ExpertAgent
from actors.browser import open_browser
from actors.rollouts import play_pages
from browser_farm.mixed import expert_of
from giirl.run.demo_stats import verbs
from giirl.statistics import Score, missing_pages, percent
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Episode, Purpose

GOOD = 0.99  # success rate that the title of the table counts


def measure(
    config: Config, episodes: int, metrics: Metrics, display: Display, rows: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Play `episodes` pages of each task of the config that `rows` lacks; yields the whole result after each task."""
    for task in config.tasks:
        expert_of(task)
    tasks = [task for task in config.tasks if task not in rows]
    agent = ExpertAgent(expert_of)
    with (
        closing(open_browser(config, metrics)) as browser,
        display.job("experts play", episodes * len(tasks)) as job,
    ):
        for task in tasks:  # one task at a time, so that every tab has work until the end
            since_s, purpose = time.monotonic(), Purpose.DEMONSTRATE
            played = play_pages(config, browser, agent, purpose, episodes, metrics, tasks=[task], job=job, note=task)
            rows[task] = {**_row(played, episodes), "seconds": round(time.monotonic() - since_s, 1)}
            yield {"episodes": episodes, "seed": config.seed, "tasks": dict(sorted(rows.items()))}


def read_rows(file: Path, episodes: int, seed: int) -> dict[str, Any]:
    """The rows of an earlier result; ValueError if it was measured with other settings."""
    if not file.exists():
        return {}
    try:
        result = json.loads(file.read_bytes())
        measured, rows = (result["episodes"], result["seed"]), dict(result["tasks"])
    except (ValueError, LookupError, TypeError) as error:
        raise ValueError(f"{file} is not a result of giirl demos experts: {error!r}") from error
    if measured != (episodes, seed):
        raise ValueError(f"{file} has (episodes, seed) {measured}: wanted {(episodes, seed)}, or another file")
    return rows


def _row(played: Sequence[Episode], wanted: int) -> dict[str, Any]:
    """The numbers of a task. Pages that no browser could play are missing, not failures."""
    score = Score(episodes=len(played), successes=sum(episode.outcome.success for episode in played))
    steps = [len(episode.trajectory) for episode in played]
    return {
        **score.row(),
        "missing": wanted - score.episodes,
        "successes": score.successes,
        "median_steps": float(np.median(steps)) if steps else 0.0,
        "most_steps": max(steps, default=0),
        "verbs": verbs(played),
    }


def experts_table(result: dict[str, Any]) -> Table:
    """For each task: success with its interval, steps and verbs."""
    at_99 = sum((row["success"] or 0.0) >= GOOD for row in result["tasks"].values())
    title = f"scripted experts, {result['episodes']} pages per task, seed {result['seed']}"
    table = Table(
        title=f"{title}: {at_99} of {len(result['tasks'])} at 99 % or more",
        caption=missing_pages(result["tasks"]) or None,
    )
    table.add_column("task", no_wrap=True)
    for name in ("success", "95 %", "median steps", "most"):
        table.add_column(name, justify="right")
    table.add_column("verbs")
    for task, row in result["tasks"].items():
        table.add_row(
            task,
            percent(row["success"]),
            f"{100 * row['low']:.1f} - {100 * row['high']:.1f}",
            f"{row['median_steps']:.0f}",
            str(row["most_steps"]),
            ", ".join(row["verbs"]),
        )
    return table
