"""Pages where something is dragged, drawn, resized, slid or selected."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from browser_farm.experts.page_view import ORDINAL, PageView, expert_for
from browser_farm.experts.shapes import kind, shapes
from giirl_core.types import Action

STEPS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "up": (0.0, -1.0), "down": (0.0, 1.0)}
PAGE = 10  # further away than this a page is no more than twice too much: it is a fifth of 5, 10, 50 or 100
PLACES = {  # of a tile: line and column
    "top left": (0, 0),
    "top center": (0, 1),
    "top right": (0, 2),
    "center left": (1, 0),
    "center": (1, 1),
    "center right": (1, 2),
    "bottom left": (2, 0),
    "bottom center": (2, 1),
    "bottom right": (2, 2),
}


@expert_for("drag-circle", "drag-single-shape")
def drag_in_a_direction(see: PageView) -> Action:
    shape = shapes(see)[0]
    across, down = STEPS[see.words(r"Drag the \w+ (\w+) then")]
    if see.page.tampered[shape]:
        return see.press_button("Submit")
    return see.drag(shape, by=(30 * across, 30 * down))


@expert_for("drag-box")
def drag_the_box_inside(see: PageView) -> Action:
    small, large = see.row("div", "s"), see.row("div", "L")
    if _inside(see, small, large):
        return see.press_button("Submit")
    return see.drag(small, to=large)


def _inside(see: PageView, row: int, box: int) -> bool:
    """Whether a row lies wholly in a box."""
    left, top, width, height = see.page.box[row] - see.page.box[box]
    return bool(left > 0 and top > 0 and left + width < 0 and top + height < 0)


def _boxes(see: PageView) -> list[int]:
    return [row for row in see.rows("rect") if see.page.colour[row] == "none"]


@expert_for("drag-shapes")
def drag_shapes_into_the_box(see: PageView) -> Action:
    wanted = see.words(r"Drag all (\w+)s into")
    return _sort_into(see, {row: _boxes(see)[0] for row in _loose(see) if kind(see, row) == wanted})


@expert_for("drag-shapes-2")
def drag_shapes_into_two_boxes(see: PageView) -> Action:
    wanted = see.words(r"Drag all (\w+?)(?:s| shapes) into")
    left, right = _boxes(see)
    loose = _loose(see)
    return _sort_into(see, {row: left if wanted in (kind(see, row), see.page.colour[row]) else right for row in loose})


def _loose(see: PageView) -> list[int]:
    boxes = set(_boxes(see))
    return [row for row in shapes(see) if row not in boxes]


def _sort_into(see: PageView, boxes: dict[int, int]) -> Action:
    for row, box in boxes.items():
        if not _inside(see, row, box):
            return see.drag(row, to=box)
    return see.press_button("Submit")


@expert_for("drag-items")
def drag_the_item(see: PageView) -> Action:
    items = see.rows("li")
    names = [see.reading(item) for item in items]
    name, where = re.findall(r"Drag (.+?) (?:to the |)(top|bottom|up|down|\d+\w\w)\b", see.said)[0]
    start = names.index(name)
    places = {"top": 0, "bottom": len(items) - 1, "up": start - 1, "down": start + 1}
    end = places[where] if where in places else int(where[:-2]) - 1
    return _reorder(see, items, start, end)


@expert_for("drag-items-grid")
def drag_the_tile(see: PageView) -> Action:
    items = see.rows("li")
    name, where = re.findall(r"Drag (.+?) (?:to the (.+)|\w+ by one)\.$", see.said)[0]
    line, column = divmod([see.reading(item) for item in items].index(name), 3)
    if where:
        to_line, to_column = PLACES[where]
    else:
        right, down = STEPS[see.words(r"(\w+) by one")]
        to_line, to_column = line + int(down), column + int(right)
    rightwards, upwards = to_column > column, to_line < line
    # A tile comes to lie behind those whose middle it has passed, also on its way.
    across = 6.0 if rightwards and not upwards else -26.0 if rightwards else -10.0
    tile, place = items[3 * line + column], items[3 * to_line + to_column]
    return see.drag(tile, to=place, by=(across, -6.0 if upwards else 0.0))


@expert_for("drag-sort-numbers")
def sort_the_numbers(see: PageView) -> Action:
    items = see.rows("li")
    numbers = [int(see.reading(item)) for item in items]
    for place, number in enumerate(sorted(numbers)):
        if numbers[place] != number:
            return _reorder(see, items, numbers.index(number, place), place)
    return see.press_button("Submit")


def _reorder(see: PageView, items: list[int], start: int, end: int) -> Action:
    """Drop an item of a list a little past the middle of the one whose place it takes."""
    return see.drag(items[start], to=items[end], by=(0.0, 4.0 if end > start else -4.0))


@expert_for("resize-textarea")
def resize_the_field(see: PageView) -> Action:
    across, larger = "width" in see.said, "larger" in see.said
    grip = see.row(kind="ui-resizable-e" if across else "ui-resizable-s")
    if see.page.tampered[grip]:
        return see.press_button("Submit")
    change = 15.0 if larger else -15.0
    return see.drag(grip, by=(change, 0.0) if across else (0.0, change))


@expert_for("draw-line")
def draw_through_the_dot(see: PageView) -> Action:
    if see.rows("path"):
        return see.press_button("Submit")
    across, down = STEPS["right" if "horizontal" in see.said else "down"]
    dot = see.row("circle")
    # A line that is quite straight has no height, and what has no height is not seen.
    return see.drag(dot, at=(-24 * across, -24 * down), by=(48 * across + down, 48 * down + across))


@expert_for("highlight-text", "highlight-text-2")
def select_the_text(see: PageView) -> Action:
    nth = re.search(ORDINAL, see.said)
    texts = see.rows("p") or [row for row in see.rows("div") if see.page.text[row]]
    text = texts[int(nth[1]) - 1 if nth else 0]
    if see.page.tampered[text]:
        return see.press_button("Submit")
    _, _, width, height = (float(each) for each in see.page.box[text])
    return see.drag(text, at=(-width / 2, 1 - height / 2), by=(width, height - 2))


@expert_for("scroll-text-2")
def scroll_the_text(see: PageView) -> Action:
    area = see.row("textarea")
    if see.page.tampered[area]:
        return see.press_button("Submit")
    return see.scroll(area, -5000.0 if "top" in see.said else 5000.0)


@expert_for("sign-agreement")
def sign_or_cancel(see: PageView) -> Action:
    if not see.quoted():
        return see.press_button("Cancel")
    name, button = see.quoted()
    area = see.row("textarea")
    if not see.page.tampered[area]:
        return see.scroll(area, 5000.0)
    return see.fill({see.row("input_text"): name}) or see.press_button(button)


@expert_for("use-slider")
def slide_to_the_number(see: PageView) -> Action:
    return _slide(see, see.rows("span", kind="ui-slider-handle"), [int(see.words(r"Select (-?\d+) with"))])


@expert_for("use-slider-2")
def slide_three(see: PageView) -> Action:
    wanted = [int(number) for number in see.words(r"\[(.+)\]").split(",")]
    return _slide(see, see.rows("span", kind="ui-slider-handle"), wanted)


@expert_for("form-sequence")
def slide_and_check(see: PageView) -> Action:
    box = see.rows("input_checkbox")[int(see.words(ORDINAL)) - 1]
    if see.page.value[box] != "checked":
        return see.click(box)
    return slide_to_the_number(see)


def _slide(see: PageView, handles: list[int], wanted: list[int]) -> Action:
    """Press keys in the handles until the numbers beside them are right, then submit."""
    shown = [int(text) for text in see.page.text if re.fullmatch(r"-?\d+", text)]
    for handle, now, goal in zip(handles, shown, wanted, strict=True):
        if now != goal:
            by_page = abs(goal - now) > PAGE
            keys = ("PageUp", "PageDown") if by_page else ("ArrowRight", "ArrowLeft")
            return see.press(keys[goal < now], handle)
    return see.press_button("Submit")


@expert_for("daily-calendar")
def enter_an_event(see: PageView) -> Action:
    """Drag over as many half hours as the event takes, where none of the others lies; then name it."""
    named = see.rows("input_text")
    if named:
        return see.fill({named[0]: see.quoted()[0]}) or see.press_button("Create")
    amount, unit = re.findall(r"Create a ([\d.]+) (hour|min)", see.said)[0]
    length = round(float(amount) * 2 if unit == "hour" else float(amount) / 30)
    clock = [12 * (half == "PM") + int(hour) % 12 for hour, half in re.findall(r"(\d+)([AP]M)", see.said)]
    slots = see.rows(kind="half-hour")
    taken = [see.page.box[row] for row in see.rows("div") if "event" in see.page.classes[row]]
    free = [all(_apart(see.page.box[slot], box) for box in taken) for slot in slots]
    first = next(i for i in range(2 * clock[0], 2 * clock[1] - length + 1) if all(free[i : i + length]))
    start, end = slots[first], slots[first + length - 1]
    area = see.page.box[0]
    if see.page.box[start, 1] < area[1] or see.page.box[end, 1] + see.page.box[end, 3] > area[1] + area[3]:
        return see.scroll(0, float(see.page.box[start, 1] - area[1]) - 20.0)
    return see.drag(start, to=end, by=(0.0, 2.0))


def _apart(box: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    """Whether one of two boxes is above the other."""
    return bool(box[1] + box[3] <= other[1] + 2 or other[1] + other[3] <= box[1] + 2)
