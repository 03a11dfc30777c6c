"""Another instruction for the same page: the same sentence, naming another element."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from giirl_core.types import NO_SPAN, Goal, Observation


@dataclass(frozen=True, slots=True, kw_only=True)
class Renamed:
    """An instruction that names another element of the page, of the same tag."""

    tag: str
    wanted: str  # what the page's own instruction names
    other: str  # what `goal` names instead
    goal: Goal


def renamed(seen: Observation, tag: str | None = None) -> Renamed | None:
    """The page's instruction with the text of another element in place of the one it names; None where it names none.

    Texts in quotes come first, then longer ones. Which other element it is, is drawn by the page's seed. With
    `tag` only such elements count.
    """
    page, goal = seen.page, seen.goal
    found: list[tuple[bool, int, str, str]] = []
    for name, text in dict.fromkeys(zip(page.tag, page.text, strict=True)):
        start, end = goal.find(text)
        if start != NO_SPAN and tag in (None, name):
            found.append((goal.tokens[start - 1 : start] == ('"',), end - start, name, text))
    for _, _, name, text in sorted(found, key=lambda one: one[:2], reverse=True):
        labels = dict.fromkeys(other for kind, other in zip(page.tag, page.text, strict=True) if kind == name and other)
        others = [label for label in labels if goal.find(label)[0] == NO_SPAN]
        if others:
            other = others[np.random.default_rng(seen.episode.seed).integers(len(others))]
            return Renamed(tag=name, wanted=text, other=other, goal=_replaced(goal, text, other))
    return None


def _replaced(goal: Goal, text: str, other: str) -> Goal:
    start, end = goal.find(text)
    said = goal.utterance
    return Goal(said[: goal.offsets[start][0]] + other + said[goal.offsets[end][1] :])
