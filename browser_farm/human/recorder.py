"""Records a person at a Chrome window: clicks, typing, drags and keys become the actions that policies use."""

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
from giirl_core.config.sections import Sandbox
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

POLL_S = 0.1
TAB = 0
AREA_TAGS = frozenset({"svg", "canvas"})  # the position of a click inside them matters
AREA_PX = 60  # an empty element that is wider and higher is an area too
TAKE_STEPS = "window.giirlRecorder&&window.giirl&&giirl.isOpen()?giirlRecorder.take():'gone'"


class Interrupted(Exception):
    """The page was closed or replaced before its episode ended."""


class Recorder:
    """One Chrome with one window, in which `record` shows a page until the person has ended its episode.

    Timeouts are in seconds. `chrome_sandbox` is as in `browser_farm.farm.ChromeFarm`.
    """

    def __init__(
        self,
        *,
        headless: bool = False,
        call_timeout_s: float = 10.0,
        launch_timeout_s: float = 60.0,
        chrome_sandbox: Sandbox = "auto",
    ) -> None:
        self._tabs = Tabs(
            1,
            view=pages.View(reader="reading", decode=pages.decode_page, first=("recorder",)),
            call_timeout_s=call_timeout_s,
            launch_timeout_s=launch_timeout_s,
            headless=headless,
            sandbox=chrome_sandbox,
        )
        try:
            self._tabs.launch()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close Chrome."""
        self._tabs.close()

    def record(self, spec: EpisodeSpec, show_instruction: Callable[[str], None]) -> Episode | None:
        """Open a page, pass its instruction to `show_instruction`, and wait for the end of the episode.

        Returns None for an episode without an action. The person may take any time; only calls to the page have a
        deadline. Interrupted if the person left the page; BrowserGone if the tab or Chrome was closed.
        """
        goal = self._open(spec)
        show_instruction(goal.utterance)
        steps: list[list[Any]] = []
        while True:
            taken, done, raw_reward = json.loads(_checked(self._tabs.evaluate({TAB: TAKE_STEPS})[TAB]))
            steps += taken
            if done:
                return _episode(spec, goal, steps, Outcome(raw_reward=float(raw_reward), ended=True))
            time.sleep(POLL_S)

    def _open(self, spec: EpisodeSpec) -> Goal:
        for failure in self._tabs.navigate({TAB: page_url(spec.task)}).values():
            raise Interrupted(f"{spec.task} cannot be opened: {failure.cause} {failure.message}")
        self._tabs.show(TAB)
        goal = pages.decode(_checked(self._tabs.ask({TAB: pages.start_call(spec)}, opening=True)[TAB]), pages.ROWS).goal
        assert goal is not None, "an opened page reports its instruction"
        return goal


def _checked(answer: Any | Failure) -> Any:
    """The answer of a page. BrowserGone if its tab is gone, Interrupted for any other failure."""
    if isinstance(answer, Failure) and answer.cause == "tab_crashed":
        raise BrowserGone("the tab was closed or crashed")
    if isinstance(answer, Failure):
        raise Interrupted(f"{answer.cause} {answer.message}".strip())
    if answer == pages.GONE:
        raise Interrupted("the page was left")
    return answer


def _episode(spec: EpisodeSpec, goal: Goal, steps: list[list[Any]], outcome: Outcome) -> Episode | None:
    """The episode of the recorder's steps, each with the page before it; None without an action."""
    kept_pages: list[Page] = []
    actions: list[Action] = []
    decoded = [pages.decode_page(columns) for columns, *_ in steps]
    for page, next_page, (_, *step) in zip(decoded, [*decoded[1:], None], steps, strict=True):
        action = action_of(page, goal, step, next_page)
        if action is not None:
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


def action_of(page: Page, goal: Goal, step: list[Any], next_page: Page | None) -> Action | None:
    """The action of one step of recorder.js, None if it had no effect.

    `step` is [verb, ref, text, x, y, dx, dy] with positions in CSS px. `next_page` is None for the last step.
    """
    verb, ref, text, x, y, dx, dy = step
    rows = np.flatnonzero(page.ref == ref)
    row = int(rows[0]) if len(rows) else NO_ELEMENT
    if verb == Verb.CLICK:
        return _click(page, row, x, y, next_page)
    if verb == Verb.TYPE:
        start, end = goal.find(text)
        return Action(verb=Verb.TYPE, element=row, start=start, end=end, literal=text if start == NO_SPAN else "")
    if verb == Verb.PRESS:
        try:
            parse_chord(text)
        except ValueError:
            return None  # a key that policies cannot press, for example the volume key
        return Action(verb=Verb.PRESS, element=row, literal=text)
    if verb == Verb.SCROLL:
        return Action(verb=Verb.SCROLL, element=row, by=(dx, dy))
    return Action(verb=Verb.DRAG, element=row, at=_offset(page, row, x, y), by=(dx, dy))


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
