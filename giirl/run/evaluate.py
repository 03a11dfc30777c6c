"""Success of a policy: greedy on fresh pages, and of the random baseline on pages of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table

from actors.browser import measured_tasks
from actors.player import AgentSpec, OpenPlayer, open_browser_player
from giirl.statistics import Score, missing_pages, percent
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Episode, Purpose, Trajectory, is_held_out
from giirl_core.weights import Weights

THESIS = {"click-test": 1.00, "click-test-2": 1.00, "click-button": 0.99, "enter-text": 0.94}  # table 4.1


def evaluate(
    config: Config,
    policy: Weights,
    metrics: Metrics,
    display: Display,
    open_player: OpenPlayer = open_browser_player,
    demonstrations: Sequence[Trajectory] = (),
) -> dict[str, Any]:
    """Success of the greedy policy and of the random baseline: the `tasks` of a result, one row per task.

    With `evaluate.agent=replay` it is success of blind replay of `demonstrations` instead.
    The pages have seeds that training, demonstrations and tuning never use. An episode that a broken browser or page
    has ended is played again; pages on which that happens each time are `missing`.
    Task files that do not say what success is have no row.
    """
    measured = measured_tasks(config)
    if unmeasured := [task for task in config.tasks if task not in measured]:
        display.say(f"not evaluated, since the task file has no [success]: {', '.join(unmeasured)}")
    if not measured:
        return {}
    agent, random = AgentSpec(kind="greedy", policy=policy), AgentSpec(kind="random")
    if config.evaluate.agent == "replay":
        agent = AgentSpec(kind="replay", demonstrations=tuple(demonstrations))
    pages, random_pages, tasks = config.evaluate.episodes, config.evaluate.random_episodes, len(measured)
    with open_player(config, metrics) as player:
        with display.job("evaluating", pages * tasks) as job:
            played = player.play(agent, Purpose.EVALUATE, pages, tasks=measured, job=job)
        with display.job("random baseline", random_pages * tasks) as job:
            at_random = player.play(random, Purpose.RANDOM, random_pages, tasks=measured, job=job)
    return {task: _row(config, task, played, at_random) for task in measured}


def _row(config: Config, task: str, played: Sequence[Episode], at_random: Sequence[Episode]) -> dict[str, Any]:
    """Success on all pages; if goals were held out of training, also on those goals and on the others."""
    trained, held_out = (_score(config, task, played, held_out) for held_out in (False, True))
    own = trained + held_out
    won = [episode.outcome.success for episode in at_random if episode.trajectory.task == task]
    random = Score(episodes=len(won), successes=sum(won))
    row = {
        **own.row(),
        "missing": config.evaluate.episodes - own.episodes,
        "random": random.success,
        "random_episodes": random.episodes,
    }
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
    table = Table(
        title=f"greedy success on fresh pages, {result['algorithm']}, seed {result['seed']}",
        caption=missing_pages(result["tasks"]) or None,
    )
    for name, side in (("task", "left"), ("random", "right"), ("success", "right"), ("95 %", "right")):
        table.add_column(name, justify=side, overflow="fold")  # type: ignore[arg-type]
    table.add_column("episodes", justify="right")
    table.add_column("thesis", justify="right")
    for task, row in result["tasks"].items():
        thesis = f"{100 * THESIS[task]:.0f}" if task in THESIS else "-"
        table.add_row(
            task,
            percent(row["random"]),
            percent(row["success"]),
            f"{100 * row['low']:.1f} - {100 * row['high']:.1f}",
            str(row["episodes"]),
            thesis,
        )
    return table
