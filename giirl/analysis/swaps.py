"""Goal swaps: the instruction of a page with the name of another of its elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from giirl_core.types import NO_SPAN, Goal, Observation


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalSwap:
    """A goal that names another element of the page, of the same tag."""

    tag: str
    wanted: str  # text of the element that the page's own goal names
    other: str  # text of the element that `goal` names instead
    goal: Goal


def swap_goal(observation: Observation, tag: str | None = None) -> GoalSwap | None:
    """Replace the element that the goal names by another one of the page; None if that is not possible.

    Of several texts that the goal contains, the first choice is one in quotes, then the longest. The page's seed
    chooses the other element. With `tag`, only elements of this tag count.
    """
    page, goal = observation.page, observation.goal
    found: list[tuple[bool, int, str, str]] = []
    for name, text in dict.fromkeys(zip(page.tag, page.text, strict=True)):
        start, end = goal.find(text)
        if start != NO_SPAN and end < len(goal.offsets) and tag in (None, name):
            quoted = goal.tokens[start - 1 : start] == ('"',)
            found.append((quoted, end - start, name, text))
    for _, _, name, text in sorted(found, key=lambda one: one[:2], reverse=True):
        labels = dict.fromkeys(other for kind, other in zip(page.tag, page.text, strict=True) if kind == name and other)
        others = [label for label in labels if goal.find(label)[0] == NO_SPAN]
        if others:
            other = others[np.random.default_rng(observation.episode.seed).integers(len(others))]
            return GoalSwap(tag=name, wanted=text, other=other, goal=_replaced(goal, text, other))
    return None


def _replaced(goal: Goal, text: str, other: str) -> Goal:
    start, end = goal.find(text)
    before, after = goal.utterance[: goal.offsets[start][0]], goal.utterance[goal.offsets[end][1] :]
    return Goal(before + other + after)
