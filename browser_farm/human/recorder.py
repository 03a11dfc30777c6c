"""A person at work in a Chrome window: clicks, typing, drags and keys become the same actions as anybody's."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from browser_farm import pages
from browser_farm.chrome.answers import Failure
from browser_farm.chrome.devtools import BrowserGone
from browser_farm.chrome.tabs import Tabs
from browser_farm.tasks import page_url
from giirl_core.keys import chord
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

POLL_S = 0.1
TAB = 0
POINTED = frozenset({"svg", "canvas"})  # what matters is where they are clicked
BARE_PX = 60  # an empty element wider and higher than this is an area, of which the same holds
TAKE = "window.giirlRecorder&&window.giirl&&giirl.isOpen()?giirlRecorder.take():'gone'"


class Interrupted(Exception):
    """The page is gone before its episode was over."""


class Recorder:
    """One Chrome with one window. `record` shows a page until the person has brought its episode to an end."""

    def __init__(
        self,
        *,
        headless: bool = False,
        call_timeout_s: float = 10.0,
        launch_timeout_s: float = 60.0,
        no_sandbox: bool | None = None,
    ) -> None:
        self._tabs = Tabs(
            1,
            view=pages.View(reader="reading", decode=pages.decode_page, first=("recorder",)),
            call_timeout_s=call_timeout_s,
            launch_timeout_s=launch_timeout_s,
            headless=headless,
            no_sandbox=no_sandbox,
        )
        self._steps: list[list[Any]] = []
        try:
            self._tabs.launch()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        self._tabs.close()

    def record(self, spec: EpisodeSpec, tell: Callable[[str], None]) -> Episode | None:
        """Open a page, `tell` its instruction, and return what was done; None for an episode without a step.

        A person may take any time: only the calls to the page have a deadline. Interrupted ends the wait when the page
        was left, BrowserGone when its tab or all of Chrome was closed.
        """
        goal = self._open(spec)
        tell(goal.utterance)
        steps: list[list[Any]] = []
        while True:
            taken, done, raw_reward = json.loads(self._said(self._tabs.evaluate({TAB: TAKE})[TAB]))
            steps += taken
            if done:
                return _episode(spec, goal, steps, Outcome(raw_reward=float(raw_reward), ended=True))
            time.sleep(POLL_S)

    def _open(self, spec: EpisodeSpec) -> Goal:
        for failure in self._tabs.navigate({TAB: page_url(spec.task)}).values():
            raise Interrupted(f"{spec.task} does not open: {failure.cause} {failure.message}")
        self._tabs.show(TAB)
        goal = pages.decode(
            self._said(self._tabs.ask({TAB: pages.start_call(spec)}, opening=True)[TAB]), pages.ROWS
        ).goal
        assert goal is not None, "a page that opens says its instruction"
        return goal

    def _said(self, answer: Any | Failure) -> Any:
        if isinstance(answer, Failure) and answer.cause == "tab_crashed":
            raise BrowserGone("the tab was closed, or crashed")
        if isinstance(answer, Failure):
            raise Interrupted(f"{answer.cause} {answer.message}".strip())
        if answer == pages.GONE:
            raise Interrupted("the page was left")
        return answer


def _episode(spec: EpisodeSpec, goal: Goal, steps: list[list[Any]], outcome: Outcome) -> Episode | None:
    seen: list[Page] = []
    actions: list[Action] = []
    shown = [pages.decode_page(columns) for columns, *_ in steps]
    for page, after, (_, *told) in zip(shown, [*shown[1:], None], steps, strict=True):
        action = action_of(page, goal, told, after)
        if action is not None:
            seen.append(page)
            actions.append(action)
    if not actions:
        return None
    trajectory = Trajectory(
        task=spec.task,
        goal=goal,
        seed=spec.seed,
        pages=tuple(seen),
        actions=tuple(actions),
        behaviour_logp=np.zeros(len(actions), dtype=np.float32),
        rewards=np.zeros(len(actions), dtype=np.float32),
        policy_version=DEMONSTRATION,
    )
    return Episode(trajectory=trajectory, outcome=outcome)


def action_of(page: Page, goal: Goal, told: list[Any], after: Page | None) -> Action | None:
    """The action that a step of recorder.js is; None for one that did nothing. `after` is missing after the last."""
    verb, ref, text, x, y, dx, dy = told
    rows = np.flatnonzero(page.ref == ref)
    row = int(rows[0]) if len(rows) else NO_ELEMENT
    if verb == Verb.CLICK:
        return _click(page, row, x, y, after)
    if verb == Verb.TYPE:
        start, end = goal.find(text)
        return Action(verb=Verb.TYPE, element=row, start=start, end=end, literal=text if start == NO_SPAN else "")
    if verb == Verb.PRESS:
        try:
            chord(text)
        except ValueError:
            return None  # a key for volume, a picture of the screen, ...
        return Action(verb=Verb.PRESS, element=row, literal=text)
    if verb == Verb.SCROLL:
        return Action(verb=Verb.SCROLL, element=row, by=(dx, dy))
    return Action(verb=Verb.DRAG, element=row, at=_offset(page, row, x, y), by=(dx, dy))


def _click(page: Page, row: int, x: float, y: float, after: Page | None) -> Action | None:
    """On the leaf under the mouse; beside all leaves, on the nearest, if the page took the click for something."""
    took = after is None or _differ(page, after)
    if row < 0:
        return Action(verb=Verb.CLICK, at=(x, y)) if after is None else None
    if page.tag[row] in POINTED:
        return Action(verb=Verb.CLICK, element=row, at=_offset(page, row, x, y))
    leaves = [each for each in (row, *page.below(row)) if page.leaf[each]]
    hit = [leaf for leaf in leaves if leaf == row or _distance(page, leaf, x, y) == 0.0]
    if not hit and not took:
        return None
    leaf = hit[-1] if hit else min(leaves, key=lambda leaf: _distance(page, leaf, x, y))
    return Action(verb=Verb.CLICK, element=leaf, at=_offset(page, leaf, x, y) if _is_area(page, leaf) else (0.0, 0.0))


def _differ(before: Page, after: Page) -> bool:
    """Whether something is shown otherwise."""
    names = ("tag", "text", "value", "classes", "colour")
    return any(getattr(before, name) != getattr(after, name) for name in names) or bool((before.box != after.box).any())


def _distance(page: Page, row: int, x: float, y: float) -> float:
    """From a point to the nearest point of a row's box, px."""
    left, top, width, height = (float(each) for each in page.box[row])
    return math.hypot(max(left - x, 0.0, x - left - width), max(top - y, 0.0, y - top - height))


def _is_area(page: Page, row: int) -> bool:
    empty = page.tag[row] == "div" and not page.text[row] and not page.classes[row]
    return page.tag[row] in POINTED or (empty and bool((page.box[row, 2:] > BARE_PX).all()))


def _offset(page: Page, row: int, x: float, y: float) -> tuple[float, float]:
    """Of a point of the page from the middle of a row, as actions have it."""
    if row < 0:
        return (float(x), float(y))
    left, top, width, height = (float(each) for each in page.box[row])
    return (float(x) - left - width / 2, float(y) - top - height / 2)
