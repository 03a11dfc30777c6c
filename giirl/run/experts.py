"""How often the scripted experts succeed: many pages a task, beside what they did on them."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from actors.agents import ExpertAgent
from actors.browser import open_browser
from actors.rollouts import Schedule, play
from browser_farm.experts import expert
from giirl.run.demo_stats import verbs
from giirl.statistics import Score
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Browser, Episode, Purpose

GOOD = 0.99


def measure(
    config: Config, episodes: int, metrics: Metrics, display: Display, rows: dict[str, Any]
) -> Iterator[dict[str, Any]]:
    """Play `episodes` pages of each of the config's tasks that `rows` lacks; the result so far after every task."""
    for task in config.tasks:
        expert(task)
    tasks = [task for task in config.tasks if task not in rows]
    browser = open_browser(config, metrics)
    try:
        with display.job("experts play", episodes * len(tasks)) as job:
            for task in tasks:  # one after another, so that every tab has work until the end
                since_s = time.monotonic()
                played = _play(config, browser, task, episodes, metrics)
                rows[task] = {**_row(played), "seconds": round(time.monotonic() - since_s, 1)}
                job.advance(len(played), task)
                yield {"episodes": episodes, "seed": config.seed, "tasks": dict(sorted(rows.items()))}
    finally:
        browser.close()


def known(file: Path, episodes: int, seed: int) -> dict[str, Any]:
    """The rows of an earlier result; ValueError where it was measured otherwise."""
    if not file.exists():
        return {}
    try:
        result = json.loads(file.read_bytes())
        measured, rows = (result["episodes"], result["seed"]), dict(result["tasks"])
    except (ValueError, LookupError, TypeError) as error:
        raise ValueError(f"{file} is no result of giirl demos experts: {error!r}") from error
    if measured != (episodes, seed):
        raise ValueError(f"{file} has (episodes, seed) {measured}: wanted {(episodes, seed)}, or another file")
    return rows


def _play(config: Config, browser: Browser, task: str, episodes: int, metrics: Metrics) -> list[Episode]:
    schedule = Schedule([task], browser.tabs, purpose=Purpose.DEMONSTRATE, run_seed=config.seed, quota=episodes)
    rounds = play(browser, ExpertAgent(expert), schedule, step_limit=config.step_limit, metrics=metrics)
    return [episode for finished in rounds for episode in finished]


def _row(played: Sequence[Episode]) -> dict[str, Any]:
    won = [episode for episode in played if episode.outcome.success]
    score = Score(episodes=len(played), successes=len(won))
    low, high = score.interval()
    steps = [len(episode.trajectory) for episode in played]
    return {
        "episodes": score.episodes,
        "successes": score.successes,
        "success": score.success,
        "low": round(low, 4),
        "high": round(high, 4),
        "median_steps": float(np.median(steps)),
        "most_steps": max(steps),
        "verbs": verbs(played),
        "learnable": all(action.learnable for episode in won for action in episode.trajectory.actions),
    }


def experts_table(result: dict[str, Any]) -> Table:
    """Task, success with its interval, steps, verbs, and whether the nets could learn it."""
    at_99 = sum(row["success"] >= GOOD for row in result["tasks"].values())
    title = f"scripted experts, {result['episodes']} pages a task, seed {result['seed']}"
    table = Table(title=f"{title}: {at_99} of {len(result['tasks'])} at 99 % or more")
    table.add_column("task", no_wrap=True)
    for name in ("success", "95 %", "median steps", "most"):
        table.add_column(name, justify="right")
    table.add_column("verbs")
    table.add_column("nets can learn it")
    for task, row in result["tasks"].items():
        table.add_row(
            task,
            f"{100 * row['success']:.1f}",
            f"{100 * row['low']:.1f} - {100 * row['high']:.1f}",
            f"{row['median_steps']:.0f}",
            str(row["most_steps"]),
            ", ".join(row["verbs"]),
            "yes" if row["learnable"] else "no",
        )
    return table
