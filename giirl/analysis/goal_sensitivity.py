"""Whether the reward reads the instruction: expert actions scored under their own goals and under other goals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from actors.player import AgentSpec, open_browser_player
from giirl.statistics import goal_sensitivity
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import RewardModel, build_reward
from giirl_core.progress import Display
from giirl_core.types import NO_ELEMENT, NO_SPAN, Action, Goal, Page, Purpose, Trajectory, is_held_out
from giirl_core.weights import Weights


@dataclass(frozen=True, slots=True)
class GoalStep:
    """One expert (s, a) with its goal."""

    page: Page
    action: Action
    goal: Goal


def sensitivity(config: Config, reward: Weights, pages: int, metrics: Metrics, display: Display) -> dict[str, Any]:
    """Per task, the fraction of expert steps with r(s, a | g) > r(s, a | g'), g' the goal of another fresh page.

    This is a paired AUC: each step is compared with itself. Only steps that depend on the goal count; pressing Submit
    is right under every goal. `shuffled` is the control: both goals belong to other pages, so 0.5 is expected. If goals
    were held out of training, `trained_goals` and `held_out_goals` give the same numbers for each group of goals alone.
    """
    model = build_reward(config, reward)
    found: dict[str, Any] = {}
    trajectories = _play_expert(config, pages, metrics, display)
    for task in config.tasks:
        steps = [step for trajectory in trajectories if trajectory.task == task for step in goal_steps(trajectory)]
        if len({step.goal for step in steps}) < 2:
            continue  # every page has the same instruction: there is no other goal to compare with
        found[task] = measure(model, steps, config.seed)
        for group, held_out in (("trained_goals", False), ("held_out_goals", True)) if config.held_out_goals else ():
            part = [step for step in steps if is_held_out(step.goal, config.held_out_goals) is held_out]
            if len({step.goal for step in part}) > 1:
                found[task][group] = measure(model, part, config.seed)
    return found


def _play_expert(config: Config, pages: int, metrics: Metrics, display: Display) -> list[Trajectory]:
    """Successful episodes of the scripted experts on pages that training and evaluation never use."""
    with (
        open_browser_player(config, metrics) as player,
        display.job("playing expert pages", pages * len(config.tasks)) as job,
    ):
        played = player.play(AgentSpec(kind="expert"), Purpose.INSPECT, pages, job=job)
    won = [episode.trajectory for episode in played if episode.outcome.success]
    return sorted(won, key=lambda trajectory: trajectory.seed)


def goal_steps(trajectory: Trajectory) -> list[GoalStep]:
    """The steps that another goal would make wrong: typing its words, and acting on an element that it names."""
    return [
        GoalStep(page, action, trajectory.goal)
        for page, action in zip(trajectory.pages, trajectory.actions, strict=True)
        if action.start != NO_SPAN or _is_named(page, action, trajectory.goal)
    ]


def _is_named(page: Page, action: Action, goal: Goal) -> bool:
    """Whether the goal quotes the text of the element that an action is on."""
    return action.element != NO_ELEMENT and f'"{page.text[action.element]}"' in goal.utterance


def measure(model: RewardModel, steps: Sequence[GoalStep], seed: int) -> dict[str, Any]:
    """The numbers of `sensitivity` for these steps, of one task, with at least two goals."""
    rng = np.random.default_rng(seed)
    own = _score(model, steps, [step.goal for step in steps])
    first, second = (_score(model, steps, [_another(step.goal, steps, rng) for step in steps]) for _ in range(2))
    return {
        "auc": goal_sensitivity(own, first),
        "shuffled": goal_sensitivity(first, second),
        "pairs": len(steps),
        "goals": len({step.goal for step in steps}),
    }


def _another(goal: Goal, steps: Sequence[GoalStep], rng: np.random.Generator) -> Goal:
    """A goal of another page that differs from this one."""
    others = [step.goal for step in steps if step.goal != goal]
    return others[rng.integers(len(others))]


def _score(model: RewardModel, steps: Sequence[GoalStep], goals: Sequence[Goal]) -> np.ndarray[Any, Any]:
    actions = []
    for step, goal in zip(steps, goals, strict=True):
        start, end = step.action.start, step.action.end
        if start != NO_SPAN and goal != step.goal:
            start, end = goal.find(step.action.text(step.goal))
        actions.append(replace(step.action, start=start, end=end))
    return model.score_pairs([step.page for step in steps], actions, goals).numpy().astype(np.float64)
