"""Does the reward read the instruction? What experts do, scored under their own goals and under others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from actors.agents import ExpertAgent
from actors.browser import open_browser
from actors.rollouts import Schedule, play
from browser_farm.experts import expert
from giirl.statistics import goal_sensitivity
from giirl_core.config import Config
from giirl_core.goals import is_held_out
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import RewardModel, build_reward
from giirl_core.progress import Display
from giirl_core.types import Action, Goal, Page, Purpose, Trajectory, Verb, Weights


@dataclass(frozen=True, slots=True)
class Pair:
    """One expert (s, a) under its goal."""

    page: Page
    action: Action
    goal: Goal


def sensitivity(config: Config, reward: Weights, pages: int, metrics: Metrics, display: Display) -> dict[str, Any]:
    """Per task, how often r(s, a | g) is above r(s, a | g'), with g' the goal of another fresh page of the task.

    That is an AUC of pairs: each step is compared with itself. Only steps whose meaning depends on the goal count:
    pressing Submit is right whatever is asked for. `shuffled` controls the measure: both goals are others', so that
    nothing but chance is left. Where goals were held out of the run's training, `trained_goals` and
    `held_out_goals` tell of either kind by itself, with others of that kind as g'.
    """
    model = build_reward(config, reward)
    found: dict[str, Any] = {}
    shown = _fresh(config, pages, metrics, display)
    for task in config.tasks:
        pairs = [pair for trajectory in shown if trajectory.task == task for pair in _telling(trajectory)]
        if len({pair.goal for pair in pairs}) < 2:
            continue  # one instruction for all pages says nothing about goals
        found[task] = _measure(model, pairs, config.seed)
        for group, held_out in (("trained_goals", False), ("held_out_goals", True)) if config.held_out_goals else ():
            part = [pair for pair in pairs if is_held_out(pair.goal, config.held_out_goals) is held_out]
            if len({pair.goal for pair in part}) > 1:
                found[task][group] = _measure(model, part, config.seed)
    return found


def _fresh(config: Config, pages: int, metrics: Metrics, display: Display) -> list[Trajectory]:
    """What scripted experts do on pages that no training or evaluation uses."""
    browser = open_browser(config, metrics)
    schedule = Schedule(config.tasks, browser.tabs, purpose=Purpose.INSPECT, run_seed=config.seed, quota=pages)
    played: list[Trajectory] = []
    try:
        with display.job("fresh expert pages", pages * len(config.tasks)) as job:
            rounds = play(browser, ExpertAgent(expert), schedule, step_limit=config.step_limit, metrics=metrics)
            for finished in rounds:
                played += [episode.trajectory for episode in finished if episode.outcome.success]
                job.advance(len(finished))
    finally:
        browser.close()
    return sorted(played, key=lambda trajectory: trajectory.seed)


def _telling(trajectory: Trajectory) -> list[Pair]:
    """The steps that another goal would make wrong: typing, and clicks on what the goal names."""
    return [
        Pair(page, action, trajectory.goal)
        for page, action in zip(trajectory.pages, trajectory.actions, strict=True)
        if action.verb is Verb.TYPE or f'"{page.text[action.element]}"' in trajectory.goal.utterance
    ]


def _measure(model: RewardModel, pairs: Sequence[Pair], seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    own = _score(model, pairs, [pair.goal for pair in pairs])
    first, second = (_score(model, pairs, [_another(pair.goal, pairs, rng) for pair in pairs]) for _ in range(2))
    return {
        "auc": goal_sensitivity(own, first),
        "shuffled": goal_sensitivity(first, second),
        "pairs": len(pairs),
        "goals": len({pair.goal for pair in pairs}),
    }


def _another(goal: Goal, pairs: Sequence[Pair], rng: np.random.Generator) -> Goal:
    """Some page's goal that is not this one."""
    others = [pair.goal for pair in pairs if pair.goal != goal]
    return others[rng.integers(len(others))]


def _score(model: RewardModel, pairs: Sequence[Pair], goals: Sequence[Goal]) -> np.ndarray[Any, Any]:
    actions = []
    for pair, goal in zip(pairs, goals, strict=True):
        start, end = pair.action.start, pair.action.end
        if pair.action.verb is Verb.TYPE and goal != pair.goal:
            start, end = goal.find(pair.action.text(pair.goal))
        actions.append(replace(pair.action, start=start, end=end))
    return model.score_pairs([pair.page for pair in pairs], actions, goals).numpy().astype(np.float64)
