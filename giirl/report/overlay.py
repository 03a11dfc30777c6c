"""The overlay on a screenshot: element outlines, reward labels and the policy's action, in CSS px of the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from giirl.report.charts import minus
from giirl.report.element_rewards import Scale, ScoredPage, by_reward, describe_action, element_name
from giirl_core.nets.layout import HEIGHT_PX, WIDTH_PX
from giirl_core.types import Page, Verb

MAX_LABELS = 16  # per screenshot, to keep it readable
MIN_HEIGHT_PX = 80.0  # of a screenshot
WIDE_RATIO = 4  # an element this many times as wide as its label has room for the label inside
LETTER_PX, LABEL_PX = 4.4, 8.6  # width of a label's characters, height of a label
MIN_OPACITY, MAX_OPACITY = 0.05, 0.28  # of the fill of an element


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle in CSS px of the page."""

    x: float
    y: float
    width: float
    height: float

    def overlap(self, other: Box) -> float:
        """The area of the intersection, in square CSS px."""
        wide = min(self.x + self.width, other.x + other.width) - max(self.x, other.x)
        high = min(self.y + self.height, other.y + other.height) - max(self.y, other.y)
        return max(wide, 0.0) * max(high, 0.0)

    def intersection(self, other: Box) -> Box | None:
        """The intersection with another box; None where it is empty."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        right = min(self.x + self.width, other.x + other.width)
        bottom = min(self.y + self.height, other.y + other.height)
        return Box(x, y, right - x, bottom - y) if right > x and bottom > y else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """The outline and fill of one element."""

    box: Box
    above_middle: bool  # whether the reward is above that of D = 1/2
    opacity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """The reward label of one element."""

    box: Box
    text: str
    above_middle: bool
    top: bool  # whether it is the highest reward on the page


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlay:
    """One page under one instruction, ready for the template."""

    instruction: str
    window: Box  # the visible area
    marks: tuple[Mark, ...]
    labels: tuple[Label, ...]  # of the MAX_LABELS elements with the highest rewards
    target: Box | None  # the element that the policy acts on; None where it is not visible
    typed_text: str  # "" unless the policy types
    typed_x: float  # x of the typed text, to the right of text that the field already contains
    action: str  # a description of the policy's action
    description: str  # for screen readers
    sketch: tuple[tuple[Box, str], ...]  # every visible element and its text, drawn where there is no screenshot


def visible_area(page: Page) -> Box:
    """The visible part of a page, without the instruction at the top and the empty space at the bottom."""
    if not len(page):
        return Box(0.0, 0.0, WIDTH_PX, HEIGHT_PX)
    top = float(np.floor(np.clip(page.box[:, 1].min(), 0, HEIGHT_PX / 2)))
    lowest = float((page.box[:, 1] + page.box[:, 3])[page.leaf].max()) + LABEL_PX
    return Box(0.0, top, WIDTH_PX, float(np.clip(np.ceil(lowest), top + MIN_HEIGHT_PX, HEIGHT_PX)) - top)


def format_reward(reward: float) -> str:
    """A reward with its sign (Unicode minus) and one decimal."""
    rounded = round(reward, 1) + 0.0
    return minus(f"{rounded:+.1f}") if rounded else "0.0"


def draw_overlay(page: Page, scored: ScoredPage, scale: Scale) -> Overlay:
    """Mark and label the visible elements of a page."""
    window = visible_area(page)
    boxes = [Box(*map(float, box)).intersection(window) for box in page.box]
    visible = [(one.reward, box) for one in by_reward(scored.best) if (box := boxes[one.action.element]) is not None]
    texts = [format_reward(reward) for reward, _ in visible[:MAX_LABELS]]
    places = place_labels([box for _, box in visible], texts, window)
    action = scored.policy_action
    target = boxes[action.element] if action is not None else None
    filled = action is not None and bool(page.value[action.element])
    return Overlay(
        instruction=scored.goal.utterance,
        window=window,
        marks=tuple(
            Mark(
                box=box,
                above_middle=reward > scale.middle,
                opacity=MIN_OPACITY + (MAX_OPACITY - MIN_OPACITY) * abs(scale.normalise(reward)),
            )
            for reward, box in visible
        ),
        labels=tuple(
            Label(box=place, text=text, above_middle=reward > scale.middle, top=reward == visible[0][0])
            for (reward, _), text, place in zip(visible, texts, places, strict=False)
        ),
        target=target,
        typed_text=action.text(scored.goal) if action is not None and action.verb is Verb.TYPE else "",
        typed_x=target.x + (0.45 * target.width if filled else 4) if target is not None else 0.0,
        action=describe_action(page, scored.goal, action)
        if action is not None
        else "none, the page has no legal action",
        description=_describe(page, scored),
        sketch=tuple((box, page.text[row] or page.value[row]) for row, box in enumerate(boxes) if box is not None),
    )


def place_labels(boxes: Sequence[Box], texts: Sequence[str], window: Box) -> list[Box]:
    """A box for each label next to or inside its element, where it covers least of the other labels and elements."""
    placed: list[Box] = []
    for box, text in zip(boxes, texts, strict=False):
        places = _places(box, LETTER_PX * len(text) + 3, window)
        costs = [cost + 4 * sum(map(at.overlap, placed)) + sum(map(at.overlap, boxes)) for at, cost in places]
        placed.append(places[costs.index(min(costs))][0])
    return placed


def _places(box: Box, width: float, window: Box) -> list[tuple[Box, float]]:
    """Candidate places of a label with their extra cost: right, left, inside at the right end, above and below."""
    middle, right = box.y + (box.height - LABEL_PX) / 2, box.x + box.width
    # The text of an element starts at its left, so the right end of a wide element is free.
    inside = 12 - LABEL_PX * width if box.width > WIDE_RATIO * width else 0
    corners = [
        (right + 1, middle, 0.0),
        (box.x - width - 1, middle, 0.0),
        (right - width - 1, middle, inside),
        (right - width, box.y - LABEL_PX, 15.0),
        (right - width, box.y + box.height, 15.0),
    ]
    return [
        (
            Box(
                _within(x, window.x, window.x + window.width - width),
                _within(y, window.y, window.y + window.height - LABEL_PX),
                width,
                LABEL_PX,
            ),
            cost,
        )
        for x, y, cost in corners
    ]


def _within(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def _describe(page: Page, scored: ScoredPage) -> str:
    action, top = scored.policy_action, scored.top
    text = f"Policy action: {describe_action(page, scored.goal, action)}." if action is not None else "No legal action."
    if top is None:
        return text
    return f"{text} Highest reward: {element_name(page, top.action.element)}, {format_reward(top.reward)}."
