"""Experts for tasks with dragging, drawing, resizing, sliders or text selection."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from browser_farm.experts.page_view import ORDINAL, PageView, expert_for
from browser_farm.experts.shapes import shape_name, shapes
from giirl_core.types import Action

DIRECTIONS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "up": (0.0, -1.0), "down": (0.0, 1.0)}
PAGE_KEY_DISTANCE = 10  # beyond it use PageUp and PageDown, which move by a fifth of the range: 1, 2, 10 or 20
TILES = {  # name -> line, column
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
def drag_in_a_direction(view: PageView) -> Action:
    shape = shapes(view)[0]
    across, down = DIRECTIONS[view.extract(r"Drag the \w+ (\w+) then")]
    if view.page.tampered[shape]:
        return view.click_button("Submit")
    return view.drag(shape, by=(30 * across, 30 * down))


@expert_for("drag-box")
def drag_the_box_inside(view: PageView) -> Action:
    small, large = view.row("div", "s"), view.row("div", "L")
    if _inside(view, small, large):
        return view.click_button("Submit")
    return view.drag(small, to=large)


def _inside(view: PageView, row: int, box: int) -> bool:
    """Whether a row is completely inside a box."""
    left, top, width, height = view.page.box[row] - view.page.box[box]
    return bool(left > 0 and top > 0 and left + width < 0 and top + height < 0)


def _boxes(view: PageView) -> list[int]:
    """The target boxes, which are rectangles without a fill."""
    return [row for row in view.rows("rect") if view.page.colour[row] == "none"]


@expert_for("drag-shapes")
def drag_shapes_into_the_box(view: PageView) -> Action:
    wanted = view.extract(r"Drag all (\w+)s into")
    return _sort_into(view, {row: _boxes(view)[0] for row in _loose(view) if shape_name(view, row) == wanted})


@expert_for("drag-shapes-2")
def drag_shapes_into_two_boxes(view: PageView) -> Action:
    wanted = view.extract(r"Drag all (\w+?)(?:s| shapes) into")
    left, right = _boxes(view)
    loose = _loose(view)
    boxes = {row: left if wanted in (shape_name(view, row), view.page.colour[row]) else right for row in loose}
    return _sort_into(view, boxes)


def _loose(view: PageView) -> list[int]:
    """The shapes that can be dragged."""
    boxes = set(_boxes(view))
    return [row for row in shapes(view) if row not in boxes]


def _sort_into(view: PageView, boxes: dict[int, int]) -> Action:
    """Drag the first shape that is not yet in its box (shape -> box); submit if all are."""
    for row, box in boxes.items():
        if not _inside(view, row, box):
            return view.drag(row, to=box)
    return view.click_button("Submit")


@expert_for("drag-items")
def drag_the_item(view: PageView) -> Action:
    items = view.rows("li")
    names = [view.all_text(item) for item in items]
    name, where = re.findall(r"Drag (.+?) (?:to the |)(top|bottom|up|down|\d+\w\w)\b", view.instruction)[0]
    start = names.index(name)
    places = {"top": 0, "bottom": len(items) - 1, "up": start - 1, "down": start + 1}
    end = places[where] if where in places else int(where[:-2]) - 1
    return _reorder(view, items, start, end)


@expert_for("drag-items-grid")
def drag_the_tile(view: PageView) -> Action:
    items = view.rows("li")
    name, where = re.findall(r"Drag (.+?) (?:to the (.+)|\w+ by one)\.$", view.instruction)[0]
    line, column = divmod([view.all_text(item) for item in items].index(name), 3)
    if where:
        to_line, to_column = TILES[where]
    else:
        right, down = DIRECTIONS[view.extract(r"(\w+) by one")]
        to_line, to_column = line + int(down), column + int(right)
    rightwards, upwards = to_column > column, to_line < line
    # A tile is inserted after every tile whose centre it has passed, also on the way there. The offsets allow for that.
    across = 6.0 if rightwards and not upwards else -26.0 if rightwards else -10.0
    tile, place = items[3 * line + column], items[3 * to_line + to_column]
    return view.drag(tile, to=place, by=(across, -6.0 if upwards else 0.0))


@expert_for("drag-sort-numbers")
def sort_the_numbers(view: PageView) -> Action:
    items = view.rows("li")
    numbers = [int(view.all_text(item)) for item in items]
    for place, number in enumerate(sorted(numbers)):
        if numbers[place] != number:
            return _reorder(view, items, numbers.index(number, place), place)
    return view.click_button("Submit")


def _reorder(view: PageView, items: list[int], start: int, end: int) -> Action:
    """Drop a list item a little past the centre of the item whose place it takes."""
    return view.drag(items[start], to=items[end], by=(0.0, 4.0 if end > start else -4.0))


@expert_for("resize-textarea")
def resize_the_field(view: PageView) -> Action:
    across, larger = "width" in view.instruction, "larger" in view.instruction
    grip = view.row(css_class="ui-resizable-e" if across else "ui-resizable-s")
    if view.page.tampered[grip]:
        return view.click_button("Submit")
    change = 15.0 if larger else -15.0
    return view.drag(grip, by=(change, 0.0) if across else (0.0, change))


@expert_for("draw-line")
def draw_through_the_dot(view: PageView) -> Action:
    if view.rows("path"):
        return view.click_button("Submit")
    across, down = DIRECTIONS["right" if "horizontal" in view.instruction else "down"]
    dot = view.row("circle")
    # A slightly slanted line: an exactly straight one has no width or height, so it would not be in the page table.
    return view.drag(dot, at=(-24 * across, -24 * down), by=(48 * across + down, 48 * down + across))


@expert_for("highlight-text", "highlight-text-2")
def select_the_text(view: PageView) -> Action:
    nth = re.search(ORDINAL, view.instruction)
    texts = view.rows("p") or [row for row in view.rows("div") if view.page.text[row]]
    text = texts[int(nth[1]) - 1 if nth else 0]
    if view.page.tampered[text]:
        return view.click_button("Submit")
    _, _, width, height = (float(each) for each in view.page.box[text])
    return view.drag(text, at=(-width / 2, 1 - height / 2), by=(width, height - 2))


@expert_for("scroll-text-2")
def scroll_the_text(view: PageView) -> Action:
    area = view.row("textarea")
    if view.page.tampered[area]:
        return view.click_button("Submit")
    return view.scroll(area, -5000.0 if "top" in view.instruction else 5000.0)


@expert_for("sign-agreement")
def sign_or_cancel(view: PageView) -> Action:
    if not view.quoted():
        return view.click_button("Cancel")
    name, button = view.quoted()
    area = view.row("textarea")
    if not view.page.tampered[area]:
        return view.scroll(area, 5000.0)
    return view.fill({view.row("input_text"): name}) or view.click_button(button)


@expert_for("use-slider")
def slide_to_the_number(view: PageView) -> Action:
    return _slide(view, view.rows("span", css_class="ui-slider-handle"), [int(view.extract(r"Select (-?\d+) with"))])


@expert_for("use-slider-2")
def slide_three(view: PageView) -> Action:
    wanted = [int(number) for number in view.extract(r"\[(.+)\]").split(",")]
    return _slide(view, view.rows("span", css_class="ui-slider-handle"), wanted)


@expert_for("form-sequence")
def slide_and_check(view: PageView) -> Action:
    box = view.rows("input_checkbox")[int(view.extract(ORDINAL)) - 1]
    if view.page.value[box] != "checked":
        return view.click(box)
    return slide_to_the_number(view)


def _slide(view: PageView, handles: list[int], wanted: list[int]) -> Action:
    """Press keys in the slider handles until the numbers next to them are right, then submit."""
    shown = [int(text) for text in view.page.text if re.fullmatch(r"-?\d+", text)]
    for handle, now, goal in zip(handles, shown, wanted, strict=True):
        if now != goal:
            by_page = abs(goal - now) > PAGE_KEY_DISTANCE
            keys = ("PageUp", "PageDown") if by_page else ("ArrowRight", "ArrowLeft")
            return view.press(keys[goal < now], handle)
    return view.click_button("Submit")


@expert_for("daily-calendar")
def enter_an_event(view: PageView) -> Action:
    """Drag over a free range of half hours as long as the event, then enter its name."""
    named = view.rows("input_text")
    if named:
        return view.fill({named[0]: view.quoted()[0]}) or view.click_button("Create")
    amount, unit = re.findall(r"Create a ([\d.]+) (hour|min)", view.instruction)[0]
    length = round(float(amount) * 2 if unit == "hour" else float(amount) / 30)
    clock = [12 * (half == "PM") + int(hour) % 12 for hour, half in re.findall(r"(\d+)([AP]M)", view.instruction)]
    slots = view.rows(css_class="half-hour")
    taken = [view.page.box[row] for row in view.rows("div") if "event" in view.page.classes[row]]
    free = [all(_apart(view.page.box[slot], box) for box in taken) for slot in slots]
    first = next(i for i in range(2 * clock[0], 2 * clock[1] - length + 1) if all(free[i : i + length]))
    start, end = slots[first], slots[first + length - 1]
    area = view.page.box[0]
    if view.page.box[start, 1] < area[1] or view.page.box[end, 1] + view.page.box[end, 3] > area[1] + area[3]:
        return view.scroll(0, float(view.page.box[start, 1] - area[1]) - 20.0)
    return view.drag(start, to=end, by=(0.0, 2.0))


def _apart(box: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    """Whether two boxes do not overlap vertically."""
    return bool(box[1] + box[3] <= other[1] + 2 or other[1] + other[3] <= box[1] + 2)
