"""Where the marks of a film strip go: outlines, numbers and the action, in the coordinates of the page they lie on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from giirl.charts import minus
from giirl.features import HEIGHT_PX, WIDTH_PX
from giirl.judged import Judged, Scale, action_words, element_name
from giirl.spec import Page, Verb

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
    """One element: its outline, how strongly it is painted, and its number beside it."""

    box: Box
    label: Box
    number: str
    good: bool  # more than what D = 1/2 earns
    top: bool  # the highest of the page
    opacity: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One page under one instruction, ready to be drawn."""

    said: str  # the instruction
    window: Box
    marks: tuple[Mark, ...]
    target: Box | None  # what the policy acts on, where it can be seen
    typed: str  # what it types there
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


def draw_shot(page: Page, judged: Judged, scale: Scale) -> Shot:
    """Put marks on what can be seen of a page."""
    window = window_of(page)
    boxes = [Box(*map(float, box)).inside(window) for box in page.box]
    top = judged.top
    seen = [(one, box) for one in judged.best if (box := boxes[one.action.element]) is not None]
    labels = place_labels([box for _, box in seen], [number(one.reward) for one, _ in seen], window)
    marks = tuple(
        Mark(
            box=box,
            label=label,
            number=number(one.reward),
            good=one.reward > scale.middle,
            top=top is not None and one.reward == top.reward,
            opacity=FAINTEST + (STRONGEST - FAINTEST) * abs(scale.share(one.reward)),
        )
        for (one, box), label in zip(seen, labels, strict=True)
    )
    choice = judged.choice
    return Shot(
        said=judged.goal.utterance,
        window=window,
        marks=marks,
        target=boxes[choice.element] if choice is not None else None,
        typed=choice.text(judged.goal) if choice is not None and choice.verb is Verb.TYPE else "",
        does=action_words(page, judged.goal, choice) if choice is not None else "nothing can be done here",
        says=_in_words(page, judged),
        sketch=tuple((box, page.text[row] or page.value[row]) for row, box in enumerate(boxes) if box is not None),
    )


def place_labels(boxes: Sequence[Box], numbers: Sequence[str], window: Box) -> list[Box]:
    """A place for each number at its element: where it hides least of the other numbers and elements."""
    placed: list[Box] = []
    for box, text in zip(boxes, numbers, strict=True):
        others = [other for other in boxes if other is not box]

        def hidden(place: tuple[Box, float], box: Box = box, others: Sequence[Box] = others) -> float:
            label, cost = place
            return cost + 4 * sum(map(label.overlap, placed)) + sum(map(label.overlap, others)) + label.overlap(box)

        placed.append(min(_places(box, LETTER_PX * len(text) + 3, window), key=hidden)[0])
    return placed


def _places(box: Box, width: float, window: Box) -> list[tuple[Box, float]]:
    """Where a number can stand, and how much worse that is: beside its element, inside at the right, above, below."""
    middle, right = box.y + (box.height - LABEL_PX) / 2, box.x + box.width
    inside = 12 - LABEL_PX * width if box.width > ROOMY * width else 0  # text begins at the left: nothing to hide
    corners = [
        (right + 1, middle, 0.0),
        (box.x - width - 1, middle, 0.0),
        (right - width - 1, middle, inside),
        (right - width, box.y - LABEL_PX, 40.0),
        (right - width, box.y + box.height, 40.0),
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


def _in_words(page: Page, judged: Judged) -> str:
    choice, top = judged.choice, judged.top
    does = f"The policy: {action_words(page, judged.goal, choice)}." if choice is not None else "Nothing can be done."
    if top is None:
        return does
    return f"{does} Highest reward: {element_name(page, top.action.element)}, {number(top.reward)}."
