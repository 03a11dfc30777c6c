"""Exploration that follows demonstrations loosely: workflow-guided exploration (WGE; Liu et al. 2018)."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from actors.agents import Decision, PolicyAgent
from giirl_core.choices import Choice, action_of
from giirl_core.config.sections import SHOWN
from giirl_core.gestures import Gesture, Takes, allowed_elements, read_gesture
from giirl_core.nets.language import Vectors
from giirl_core.nets.models import PolicyNet
from giirl_core.types import NO_SPAN, Action, Goal, Observation, Page, Trajectory

EXPLORING = 0.5  # share of the episodes that follow a workflow; the policy plays the others
MAX_TEXT = 60  # characters of an element's text that a step may ask for


class Loosely(NamedTuple):
    """What a step of a demonstration may be taken for. It allows all actions that are alike in this respect."""

    gesture: Gesture
    where: str  # what is known of the element: its "text", its "tag", that it shows "words" of the goal, or "any"
    value: str = ""  # that text or tag
    quoted: int = -1  # which quoted text of the goal is typed; -1: any words


@dataclass(frozen=True, slots=True)
class Workflow:
    """A demonstration, each of its steps as everything that it may be taken for."""

    task: str
    steps: tuple[tuple[Loosely, ...], ...]

    def __str__(self) -> str:
        return json.dumps([self.task, self.steps], ensure_ascii=False, default=str)


def read_workflow(text: str) -> Workflow:
    """The inverse of `str`; ValueError, one line, for a text that is no workflow."""
    try:
        task, steps = json.loads(text)
        return Workflow(
            task, tuple(tuple(Loosely(read_gesture(what), *rest) for what, *rest in step) for step in steps)
        )
    except (ValueError, TypeError):
        raise ValueError(f"{text!r:.80} is no workflow") from None


def read_workflows(texts: Sequence[str]) -> tuple[Workflow, ...]:
    """The workflows of a run. SHOWN stands for none: those of the demonstrations are filled in when they are there."""
    return tuple(read_workflow(text) for text in texts if text != SHOWN)


def workflow_of(demonstration: Trajectory, gestures: Sequence[Gesture]) -> Workflow:
    """The workflow of a demonstration. ValueError for one with an action that is none of the gestures."""
    goal, choices = demonstration.goal, demonstration.choices(gestures)
    steps = zip(demonstration.pages, demonstration.actions, choices, strict=True)
    loosely = (_loosely(page, goal, action, gestures[one.gesture], one.element) for page, action, one in steps)
    return Workflow(demonstration.task, tuple(loosely))


def _loosely(page: Page, goal: Goal, action: Action, gesture: Gesture, element: int) -> tuple[Loosely, ...]:
    text, tag = page.text[element], page.tag[element]
    where = [("tag", tag), ("any", "")]
    if 0 < len(text) <= MAX_TEXT:
        where = [("text", text), *([("words", "")] if goal.find(text)[0] != NO_SPAN else []), *where]
    typed = [-1]
    if gesture.takes is Takes.WORDS:
        typed = [n for n, quoted in enumerate(goal.quoted) if quoted == action.text(goal)] + typed
    return tuple(Loosely(gesture, *one, number) for one, number in product(where, typed))


def allowed_choices(step: Loosely, page: Page, goal: Goal, gestures: Sequence[Gesture]) -> list[Choice]:
    """All choices on a page that a step of a workflow allows."""
    number, arguments = gestures.index(step.gesture), list(_arguments(step, page, goal))
    rows = map(int, np.flatnonzero(allowed_elements(step.gesture, page)))
    return [Choice(number, row, *rest) for row in rows if _fits(step, page, goal, row) for rest in arguments]


def _fits(step: Loosely, page: Page, goal: Goal, row: int) -> bool:
    if step.where == "text":
        return page.text[row] == step.value
    if step.where == "words":
        return bool(page.text[row]) and goal.find(page.text[row])[0] != NO_SPAN
    return step.where == "any" or page.tag[row] == step.value


def _arguments(step: Loosely, page: Page, goal: Goal) -> Iterator[tuple[int, int]]:
    """What a gesture needs besides its element: words of the goal, another element, or nothing."""
    if step.gesture.takes is Takes.WORDS:
        if step.quoted < 0:
            yield from ((a, b) for a in range(len(goal.tokens)) for b in range(a, len(goal.tokens)))
        elif step.quoted < len(goal.quoted) and (span := goal.find(goal.quoted[step.quoted]))[0] != NO_SPAN:
            yield span
    elif step.gesture.has_second:
        yield from ((row, NO_SPAN) for row in range(len(page)))
    else:
        yield NO_SPAN, NO_SPAN


class WorkflowAgent(PolicyAgent):
    """Explores as WGE does: in half of the episodes each action is a random one that a step of a workflow allows.

    The workflow is that of a random demonstration of the task, and the step is taken for one of the things that it may
    be, at random. Where a page has no such action and after the last step, as in the other half of the episodes, the
    policy acts.
    """

    def __init__(self, net: PolicyNet, vectors: Vectors, workflows: Sequence[Workflow]) -> None:
        super().__init__(net, vectors)
        for one in (one for workflow in workflows for step in workflow.steps for one in step):
            if one.gesture not in net.gestures:
                raise ValueError(f"a workflow has the gesture {str(one.gesture)!r:.80}, which net.gestures lacks")
        self._workflows = workflows

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        """See `Agent.select_actions`. The log-probability of an exploring action is that within its step."""
        decisions = super().select_actions(observations, uniform)
        return [self._explore(one, decision) for one, decision in zip(observations, decisions, strict=True)]

    def _steps(self, observation: Observation) -> tuple[tuple[Loosely, ...], ...]:
        """The steps of the workflow that this episode follows; none if the policy plays it."""
        rng = np.random.default_rng([observation.episode.seed, 2])
        own = [one for one in self._workflows if one.task == observation.episode.task]
        follows = bool(own) and rng.random() < EXPLORING
        return own[rng.integers(len(own))].steps if follows else ()

    def _explore(self, observation: Observation, decision: Decision) -> Decision:
        steps, t = self._steps(observation), observation.step
        if t >= len(steps):
            return decision
        rng = np.random.default_rng([observation.episode.seed, 3, t])
        loosely = steps[t][rng.integers(len(steps[t]))]
        allowed = allowed_choices(loosely, observation.page, observation.goal, self.net.gestures)
        if not allowed:
            return decision
        action = action_of(allowed[rng.integers(len(allowed))], observation.page, self.net.gestures)
        return Decision(action, -math.log(len(allowed)), self.version)
