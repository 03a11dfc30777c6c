"""A person's steps on pages become the actions that policies use."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from browser_farm.human.spans import equivalent_span
from giirl_core.keys import parse_chord
from giirl_core.types import (
    DEMONSTRATION,
    NO_ELEMENT,
    NO_SPAN,
    Action,
    Episode,
    EpisodeSpec,
    Goal,
    Outcome,
    Page,
    Trajectory,
    Verb,
)

POLL_S = 0.1  # how often a page that is recorded is asked
AREA_TAGS = frozenset({"svg", "canvas"})  # the position of a click inside them matters
AREA_PX = 60  # an empty element that is wider and higher is an area too

FindSpan = Callable[[str], tuple[int, int]]  # from a text to its first and last token in the goal


class Interrupted(Exception):
    """The page was closed, replaced or broken before its episode ended."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One step of person.js, with the page before it. Positions and distances are in the units of `Page.box`."""

    page: Page
    verb: Verb
    ref: int  # Page.ref of its element, 0 for none
    text: str  # what a field holds after typing, or the key
    at: tuple[float, float]  # of the mouse on the page
    by: tuple[float, float]
    document: int | None = None  # of the page, if the page does not say itself what was acted on (`Page.tampered`)


def episode_of(spec: EpisodeSpec, goal: Goal, steps: Sequence[Step], outcome: Outcome) -> Episode | None:
    """The episode of a person's steps; None without an action.

    Typed text becomes the words of the goal that it equals; after success, words that have the same effect.
    """

    def find(text: str) -> tuple[int, int]:
        return equivalent_span(goal, text) if outcome.success else goal.find(text)

    kept_pages: list[Page] = []
    actions: list[Action] = []
    acted: dict[int, set[int]] = {}  # document -> refs
    for number, step in enumerate(steps):
        following = steps[number + 1] if number + 1 < len(steps) else None
        action = action_of(step, find, following.page if following is not None else None)
        if action is None:
            continue
        page = step.page
        if step.document is not None:
            refs = acted.setdefault(step.document, set())
            page = replace(page, tampered=np.isin(page.ref, list(refs)))
            refs |= _acted_on(page, action)
        kept_pages.append(page)
        actions.append(action)
    if not actions:
        return None
    trajectory = Trajectory(
        task=spec.task,
        goal=goal,
        seed=spec.seed,
        pages=tuple(kept_pages),
        actions=tuple(actions),
        behaviour_logp=np.zeros(len(actions), dtype=np.float32),
        rewards=np.zeros(len(actions), dtype=np.float32),
        policy_version=DEMONSTRATION,
    )
    return Episode(trajectory=trajectory, outcome=outcome)


def _acted_on(page: Page, action: Action) -> set[int]:
    """The refs of what an action leaves its mark on: its element, and the list of an option."""
    if action.element < 0:
        return set()
    rows = [action.element]
    if page.tag[action.element] == "option" and page.parent[action.element] >= 0:
        rows.append(int(page.parent[action.element]))
    return {int(page.ref[row]) for row in rows}


def action_of(step: Step, find: FindSpan, next_page: Page | None) -> Action | None:
    """The action of one step, None if it had no effect. `next_page` is None for the last step."""
    rows = np.flatnonzero(step.page.ref == step.ref)
    row = int(rows[0]) if len(rows) else NO_ELEMENT
    if step.verb == Verb.CLICK:
        return _click(step.page, row, *step.at, next_page)
    if step.verb == Verb.TYPE:
        if row >= 0 and not step.page.typable[row]:
            row = NO_ELEMENT  # a field that is not seen, inside this element: it has the focus
        start, end = find(step.text)
        literal = step.text if start == NO_SPAN else ""
        return Action(verb=Verb.TYPE, element=row, start=start, end=end, literal=literal)
    if step.verb == Verb.PRESS:
        try:
            parse_chord(step.text)
        except ValueError:
            return None  # a key that policies cannot press, for example the volume key
        return Action(verb=Verb.PRESS, element=row, literal=step.text)
    if step.verb == Verb.SCROLL:
        return Action(verb=Verb.SCROLL, element=row, by=step.by)
    return Action(verb=Verb.DRAG, element=row, at=_offset(step.page, row, *step.at), by=step.by)


def _click(page: Page, row: int, x: float, y: float, next_page: Page | None) -> Action | None:
    """A click on the leaf under the mouse. Outside all leaves: on the nearest leaf, or None if nothing changed."""
    had_effect = next_page is None or _differ(page, next_page)
    if row < 0:
        return Action(verb=Verb.CLICK, at=(x, y)) if next_page is None else None
    if page.tag[row] in AREA_TAGS:
        return Action(verb=Verb.CLICK, element=row, at=_offset(page, row, x, y))
    leaves = [candidate for candidate in (row, *page.descendants(row)) if page.leaf[candidate]]
    hit = [leaf for leaf in leaves if leaf == row or _distance(page, leaf, x, y) == 0.0]
    if not hit and not had_effect:
        return None
    leaf = hit[-1] if hit else min(leaves, key=lambda leaf: _distance(page, leaf, x, y))
    return Action(verb=Verb.CLICK, element=leaf, at=_offset(page, leaf, x, y) if _is_area(page, leaf) else (0.0, 0.0))


def _differ(before: Page, after: Page) -> bool:
    """Whether two pages look different. The focus does not count."""
    names = ("tag", "text", "value", "classes", "colour")
    return any(getattr(before, name) != getattr(after, name) for name in names) or bool((before.box != after.box).any())


def _distance(page: Page, row: int, x: float, y: float) -> float:
    """Distance of a point to the nearest point of a row's box, px."""
    left, top, width, height = map(float, page.box[row])
    return math.hypot(max(left - x, 0.0, x - left - width), max(top - y, 0.0, y - top - height))


def _is_area(page: Page, row: int) -> bool:
    """Whether the position of a click inside the element matters."""
    empty = page.tag[row] == "div" and not page.text[row] and not page.classes[row]
    return page.tag[row] in AREA_TAGS or (empty and bool((page.box[row, 2:] > AREA_PX).all()))


def _offset(page: Page, row: int, x: float, y: float) -> tuple[float, float]:
    """Offset of a point of the page from the centre of a row, px; the point itself for NO_ELEMENT."""
    if row < 0:
        return (float(x), float(y))
    left, top, width, height = map(float, page.box[row])
    return (float(x) - left - width / 2, float(y) - top - height / 2)
