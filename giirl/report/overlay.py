"""Where the marks of a film strip go: outlines, numbers and the action, in the coordinates of the page they lie on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from giirl.report.charts import minus
from giirl.report.element_rewards import Scale, ScoredPage, action_words, element_name, ranked
from giirl_core.nets.features import HEIGHT_PX, WIDTH_PX
from giirl_core.types import Page, Verb

MOST_LABELS = 16  # numbers on one picture; beyond that nobody reads them
LEAST_PX = 80.0  # height of a picture
ROOMY = 4  # times as wide as its number is an element with room for it
LETTER_PX, LABEL_PX = 4.4, 8.6  # size of a number's characters on the page
FAINTEST, STRONGEST = 0.05, 0.28  # opacity of an element's paint


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle in CSS px of the page."""

    x: float
    y: float
    width: float
    height: float

    def overlap(self, other: Box) -> float:
        """Square pixels that both cover."""
        wide = min(self.x + self.width, other.x + other.width) - max(self.x, other.x)
        high = min(self.y + self.height, other.y + other.height) - max(self.y, other.y)
        return max(wide, 0.0) * max(high, 0.0)

    def inside(self, other: Box) -> Box | None:
        """The part of it inside another; None where there is none."""
        x, y = max(self.x, other.x), max(self.y, other.y)
        right = min(self.x + self.width, other.x + other.width)
        bottom = min(self.y + self.height, other.y + other.height)
        return Box(x, y, right - x, bottom - y) if right > x and bottom > y else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """One element: its outline, and how strongly it is painted."""

    box: Box
    good: bool  # more than what D = 1/2 earns
    opacity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """The number of one element, and where it stands."""

    box: Box
    text: str
    good: bool
    top: bool  # the highest of the page


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlay:
    """One page under one instruction, ready to be drawn."""

    said: str  # the instruction
    window: Box
    marks: tuple[Mark, ...]
    labels: tuple[Label, ...]  # of the MOST_LABELS elements with the highest rewards
    target: Box | None  # what the policy acts on, where it can be seen
    typed: str  # what it types there
    typed_x: float  # where that is written: behind what the field holds already
    does: str  # its action, in words
    says: str  # what a reader who sees no picture is told
    sketch: tuple[tuple[Box, str], ...]  # every element and its text, where there is no picture


def window_of(page: Page) -> Box:
    """What a person sees of a page, without the instruction above it and the empty space below."""
    if not len(page):
        return Box(0.0, 0.0, WIDTH_PX, HEIGHT_PX)
    top = float(np.floor(np.clip(page.box[:, 1].min(), 0, HEIGHT_PX / 2)))
    lowest = float((page.box[:, 1] + page.box[:, 3])[page.leaf].max()) + LABEL_PX
    return Box(0.0, top, WIDTH_PX, float(np.clip(np.ceil(lowest), top + LEAST_PX, HEIGHT_PX)) - top)


def number(reward: float) -> str:
    """A reward, signed, with one decimal and a true minus."""
    rounded = round(reward, 1) + 0.0
    return minus(f"{rounded:+.1f}") if rounded else "0.0"


def draw_shot(page: Page, judged: ScoredPage, scale: Scale) -> Overlay:
    """Put marks on what can be seen of a page."""
    window = window_of(page)
    boxes = [Box(*map(float, box)).inside(window) for box in page.box]
    seen = [(one.reward, box) for one in ranked(judged.best) if (box := boxes[one.action.element]) is not None]
    places = place_labels([box for _, box in seen], [number(reward) for reward, _ in seen[:MOST_LABELS]], window)
    choice = judged.choice
    target = boxes[choice.element] if choice is not None else None
    held = choice is not None and bool(page.value[choice.element])
    return Overlay(
        said=judged.goal.utterance,
        window=window,
        marks=tuple(
            Mark(
                box=box,
                good=reward > scale.middle,
                opacity=FAINTEST + (STRONGEST - FAINTEST) * abs(scale.share(reward)),
            )
            for reward, box in seen
        ),
        labels=tuple(
            Label(box=place, text=number(reward), good=reward > scale.middle, top=reward == seen[0][0])
            for (reward, _), place in zip(seen, places, strict=False)
        ),
        target=target,
        typed=choice.text(judged.goal) if choice is not None and choice.verb is Verb.TYPE else "",
        typed_x=target.x + (0.45 * target.width if held else 4) if target is not None else 0.0,
        does=action_words(page, judged.goal, choice) if choice is not None else "nothing can be done here",
        says=_in_words(page, judged),
        sketch=tuple((box, page.text[row] or page.value[row]) for row, box in enumerate(boxes) if box is not None),
    )


def place_labels(boxes: Sequence[Box], numbers: Sequence[str], window: Box) -> list[Box]:
    """A place for each of the numbers at its box: where it hides least of the other numbers and of all boxes."""
    placed: list[Box] = []
    for box, text in zip(boxes, numbers, strict=False):
        places = _places(box, LETTER_PX * len(text) + 3, window)
        costs = [cost + 4 * sum(map(at.overlap, placed)) + sum(map(at.overlap, boxes)) for at, cost in places]
        placed.append(places[costs.index(min(costs))][0])
    return placed


def _places(box: Box, width: float, window: Box) -> list[tuple[Box, float]]:
    """Where a number can stand, and how much worse that is: beside its element, inside at the right, above, below."""
    middle, right = box.y + (box.height - LABEL_PX) / 2, box.x + box.width
    inside = 12 - LABEL_PX * width if box.width > ROOMY * width else 0  # text begins at the left: nothing to hide
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


def _in_words(page: Page, judged: ScoredPage) -> str:
    choice, top = judged.choice, judged.top
    does = f"The policy: {action_words(page, judged.goal, choice)}." if choice is not None else "Nothing can be done."
    if top is None:
        return does
    return f"{does} Highest reward: {element_name(page, top.action.element)}, {number(top.reward)}."
