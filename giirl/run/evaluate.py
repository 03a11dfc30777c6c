"""How good a policy is: greedy on fresh pages, beside chance on pages of its own."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from actors.agents import Agent, PolicyAgent, RandomAgent
from actors.browser import open_browser
from actors.rollouts import Schedule, play
from giirl.statistics import Score
from giirl_core.config import Config
from giirl_core.goals import is_held_out
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.nets.parameters import load_net
from giirl_core.nets.reward import build_policy
from giirl_core.progress import Display
from giirl_core.types import Browser, Purpose, Weights

THESIS = {"click-test": 1.00, "click-test-2": 1.00, "click-button": 0.99, "enter-text": 0.94}  # table 4.1


def evaluate(config: Config, policy: Weights, metrics: Metrics, display: Display) -> dict[str, Any]:
    """Success of the greedy policy and of chance: the `tasks` of a result.

    Pages come from seeds that neither training, demonstrations nor tuning ever use.
    """
    net = build_policy(config)
    load_net(net, policy)
    greedy = PolicyAgent(net, load_vectors(config.net.vectors), version=policy.version, greedy=True)
    browser = open_browser(config, metrics)
    try:
        scores = _measure(
            config, browser, greedy, Purpose.EVALUATE, config.evaluate.episodes, metrics, display, "evaluating"
        )
        floor = _measure(
            config,
            browser,
            RandomAgent(),
            Purpose.RANDOM,
            config.evaluate.random_episodes,
            metrics,
            display,
            "random baseline",
        )
    finally:
        browser.close()
    return {task: _row(scores[task], floor[task]) for task in config.tasks}


def _row(scores: tuple[Score, Score], floors: tuple[Score, Score]) -> dict[str, Any]:
    """All pages together; and, where goals were held out, theirs and the others' apart."""
    floor = floors[0] + floors[1]
    row = {**_success(scores[0] + scores[1]), "random": floor.success, "random_episodes": floor.episodes}
    if all(score.episodes for score in scores):
        row |= {"trained_goals": _success(scores[0]), "held_out_goals": _success(scores[1])}
    return row


def _success(score: Score) -> dict[str, Any]:
    low, high = score.interval()
    return {"episodes": score.episodes, "success": score.success, "low": round(low, 4), "high": round(high, 4)}


def _measure(
    config: Config,
    browser: Browser,
    chooser: Agent,
    purpose: Purpose,
    episodes: int,
    metrics: Metrics,
    display: Display,
    what: str,
) -> dict[str, tuple[Score, Score]]:
    """Success under goals that training saw, and under those held out."""
    schedule = Schedule(config.tasks, browser.tabs, purpose=purpose, run_seed=config.seed, quota=episodes)
    scores = {task: [Score(episodes=0, successes=0), Score(episodes=0, successes=0)] for task in config.tasks}
    with display.job(what, episodes * len(config.tasks)) as job:
        for finished in play(browser, chooser, schedule, step_limit=config.step_limit, metrics=metrics):
            for episode in finished:
                one = Score(episodes=1, successes=int(episode.outcome.success))
                scores[episode.trajectory.task][is_held_out(episode.trajectory.goal, config.held_out_goals)] += one
            job.advance(len(finished))
    for task, (seen, unseen) in scores.items():  # pages that never opened, or showed nothing to act on, are failures
        scores[task][0] = Score(episodes=episodes - unseen.episodes, successes=seen.successes)
    return {task: (seen, unseen) for task, (seen, unseen) in scores.items()}


def result_table(result: dict[str, Any]) -> Table:
    """Task, floor, success with its interval, the thesis's figure."""
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
