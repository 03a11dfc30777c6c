"""Success of a policy: greedy on fresh pages, and of the random baseline on pages of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from actors.player import AgentSpec, OpenPlayer, open_browser_player
from giirl.statistics import Score
from giirl_core.config import Config
from giirl_core.goals import is_held_out
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Episode, Purpose
from giirl_core.weights import Weights

THESIS = {"click-test": 1.00, "click-test-2": 1.00, "click-button": 0.99, "enter-text": 0.94}  # table 4.1


def evaluate(
    config: Config,
    policy: Weights,
    metrics: Metrics,
    display: Display,
    open_player: OpenPlayer = open_browser_player,
) -> dict[str, Any]:
    """Success of the greedy policy and of the random baseline: the `tasks` of a result, one row per task.

    The pages have seeds that training, demonstrations and tuning never use.
    """
    greedy, random = AgentSpec(kind="greedy", policy=policy), AgentSpec(kind="random")
    pages, random_pages, tasks = config.evaluate.episodes, config.evaluate.random_episodes, len(config.tasks)
    with open_player(config, metrics) as player:
        with display.job("evaluating", pages * tasks) as job:
            played = player.play(greedy, Purpose.EVALUATE, pages, job=job)
        with display.job("random baseline", random_pages * tasks) as job:
            at_random = player.play(random, Purpose.RANDOM, random_pages, job=job)
    return {task: _row(config, task, played, at_random) for task in config.tasks}


def _row(config: Config, task: str, played: Sequence[Episode], at_random: Sequence[Episode]) -> dict[str, Any]:
    """Success on all pages; if goals were held out of training, also on those goals and on the others."""
    trained, held_out = (_score(config, task, played, held_out) for held_out in (False, True))
    trained = Score(episodes=config.evaluate.episodes - held_out.episodes, successes=trained.successes)
    random = Score(
        episodes=config.evaluate.random_episodes,
        successes=sum(episode.outcome.success for episode in at_random if episode.trajectory.task == task),
    )
    row = {**(trained + held_out).row(), "random": random.success, "random_episodes": random.episodes}
    if trained.episodes and held_out.episodes:
        row |= {"trained_goals": trained.row(), "held_out_goals": held_out.row()}
    return row


def _score(config: Config, task: str, played: Sequence[Episode], held_out: bool) -> Score:
    """Of the episodes of a task whose goal was, or was not, held out of training."""
    won = [
        episode.outcome.success
        for episode in played
        if episode.trajectory.task == task and is_held_out(episode.trajectory.goal, config.held_out_goals) is held_out
    ]
    return Score(episodes=len(won), successes=sum(won))


def result_table(result: dict[str, Any]) -> Table:
    """For each task: success of the random baseline, success with its interval, and the figure of the thesis."""
    table = Table(title=f"greedy success on fresh pages, {result['algorithm']}, seed {result['seed']}")
    for name, side in (("task", "left"), ("random", "right"), ("success", "right"), ("95 %", "right")):
        table.add_column(name, justify=side)  # type: ignore[arg-type]
    table.add_column("episodes", justify="right")
    table.add_column("thesis", justify="right")
    for task, row in result["tasks"].items():
        thesis = f"{100 * THESIS[task]:.0f}" if task in THESIS else "-"
        table.add_row(
            task,
            f"{100 * row['random']:.1f}",
            f"{100 * row['success']:.1f}",
            f"{100 * row['low']:.1f} - {100 * row['high']:.1f}",
            str(row["episodes"]),
            thesis,
        )
    return table
