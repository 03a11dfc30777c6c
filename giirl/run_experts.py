"""How often the scripted experts succeed: many pages a task, beside what they did on them."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table

from actors.choosers import ExpertChooser
from actors.rollouts import Schedule, play
from browser_farm.experts import expert
from giirl.config import Config
from giirl.demo_stats import verbs
from giirl.metrics import Metrics
from giirl.progress import Display
from giirl.run_browser import open_browser
from giirl.spec import Browser, Episode, Purpose
from giirl.statistics import Score

GOOD = 0.99


def measure(config: Config, episodes: int, metrics: Metrics, display: Display) -> dict[str, Any]:
    """Play `episodes` pages of each of the config's tasks, and say how it went."""
    for task in config.tasks:
        expert(task)
    since_s = time.monotonic()
    browser = open_browser(config, metrics)
    rows: dict[str, Any] = {}
    try:
        with display.job("experts play", episodes * len(config.tasks)) as job:
            for task in config.tasks:  # one after another, so that every tab has work until the end
                played = _play(config, browser, task, episodes, metrics)
                rows[task] = _row(played)
                job.advance(len(played), task)
    finally:
        browser.close()
    return {
        "episodes": episodes,
        "seed": config.seed,
        "seconds": round(time.monotonic() - since_s, 1),
        "at_99": sum(row["success"] >= GOOD for row in rows.values()),
        "tasks": rows,
    }


def _play(config: Config, browser: Browser, task: str, episodes: int, metrics: Metrics) -> list[Episode]:
    schedule = Schedule([task], browser.tabs, purpose=Purpose.DEMONSTRATE, run_seed=config.seed, quota=episodes)
    rounds = play(browser, ExpertChooser(expert), schedule, step_limit=config.step_limit, metrics=metrics)
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
        "learnable": all(action.learned for episode in won for action in episode.trajectory.actions),
    }


def experts_table(result: dict[str, Any]) -> Table:
    """Task, success with its interval, steps, verbs, and whether the nets could learn it."""
    table = Table(title=f"scripted experts, {result['episodes']} pages a task, seed {result['seed']}")
    table.add_column("task")
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
