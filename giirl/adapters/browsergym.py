"""Observations and actions of BrowserGym as pages and actions, so that the learned reward ranks an agent's candidates.

scores = score_candidates(LearnedReward("runs/mine"), observation, ["click('12')", "fill('16', 'Ada')"])
"""

from __future__ import annotations

import ast
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from giirl.adapters.dom_snapshot import read_rows
from giirl.run.api import LearnedReward
from giirl_core.types import NO_SPAN, Action, Goal, Page, Verb


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPage:
    """A page of BrowserGym as the nets read it."""

    page: Page
    goal: Goal
    bids: tuple[str, ...]  # [E] BrowserGym's names of the elements, "" for bare text

    def action(self, candidate: str) -> Action | None:
        """The action of a line such as `click('12')`, `fill('16', 'Ada')`, `check('9')` or `select_option('7', 'x')`.

        None for one that the nets do not know: another function, an element that cannot be seen, other words than the
        goal's. ValueError for text that is no call.
        """
        name, values = _call(candidate)
        if not values or values[0] not in self.bids or not values[0]:
            return None
        row = self.bids.index(values[0])
        if name == "click" and len(values) == 1:
            return Action(verb=Verb.CLICK, element=row)
        if name in ("check", "uncheck") and (self.page.value[row] == "checked") == (name == "uncheck"):
            return Action(verb=Verb.CLICK, element=row)
        if name == "fill" and len(values) == 2 and self.page.typable[row]:
            start, end = self.goal.find(values[1])
            return None if start == NO_SPAN else Action(verb=Verb.TYPE, element=row, start=start, end=end)
        if name == "select_option" and len(values) == 2:
            options = [option for option in self.page.descendants(row) if self.page.text[option] == values[1]]
            return Action(verb=Verb.CLICK, element=options[0]) if options else None
        return None


def read_observation(observation: Mapping[str, Any], *, acted: Collection[str] = (), scale: float = 1.0) -> SeenPage:
    """The page and the goal of an observation. Its frames and drawings are not read.

    `acted` are the names (bids) of elements that were acted on earlier in the episode. `scale` is the number of px of a
    MiniWoB page, which is 160 wide, in a CSS px. ValueError for an observation without `dom_object` or without a goal.
    """
    if not observation.get("dom_object"):
        raise ValueError("the observation has no dom_object: wanted one of BrowserGym's default observations")
    goal = Goal(str(observation.get("goal", "")))
    rows = read_rows(observation["dom_object"])
    focused = observation.get("focused_element_bid") or None
    page = Page(
        tag=tuple(row.tag for row in rows),
        text=tuple(row.text for row in rows),
        value=tuple(row.value for row in rows),
        classes=tuple(row.classes for row in rows),
        colour=tuple(row.colour for row in rows),
        attributes=tuple(row.attributes for row in rows),
        ref=np.arange(1, len(rows) + 1, dtype=np.int32),
        parent=np.array([row.parent for row in rows], dtype=np.int16),
        box=np.array([row.box for row in rows], dtype=np.float32).reshape(-1, 4) * np.float32(scale),
        focused=np.array([row.bid == focused for row in rows], dtype=np.bool_),
        tampered=np.array([bool(row.bid) and row.bid in acted for row in rows], dtype=np.bool_),
    )
    return SeenPage(page=page, goal=goal, bids=tuple(row.bid for row in rows))


def score_candidates(
    reward: LearnedReward,
    observation: Mapping[str, Any],
    candidates: Sequence[str],
    *,
    acted: Collection[str] = (),
    scale: float = 1.0,
) -> list[float | None]:
    """The learned reward of each candidate; None for one that the nets do not know. See `read_observation`."""
    seen = read_observation(observation, acted=acted, scale=scale)
    actions = [seen.action(candidate) for candidate in candidates]
    known = [action for action in actions if action is not None]
    rewards = iter(reward.score_actions(seen.page, known, seen.goal).tolist() if known else ())
    return [None if action is None else next(rewards) for action in actions]


def _call(candidate: str) -> tuple[str, list[str]]:
    """The function and the texts of a call; no texts where its arguments are others than one or two texts."""
    try:
        call = ast.parse(candidate.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        call = None
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
        raise ValueError(f"{candidate!r:.80} is no action: wanted one call, as in click('12')")
    texts = [value.value for value in call.args if isinstance(value, ast.Constant) and isinstance(value.value, str)]
    return call.func.id, texts if len(texts) == len(call.args) and not call.keywords else []
