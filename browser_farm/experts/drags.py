"""Pages where something is dragged, drawn, resized, slid or selected."""

from __future__ import annotations

import re

from browser_farm.experts.shapes import kind, shapes
from browser_farm.experts.sight import ORDINAL, Sight, plays
from giirl.spec import Action

STEPS = {"left": (-1.0, 0.0), "right": (1.0, 0.0), "up": (0.0, -1.0), "down": (0.0, 1.0)}
PLACES = ("top left", "top center", "top right", "center left", "center", "center right")
PLACES = (*PLACES, "bottom left", "bottom center", "bottom right")


@plays("drag-circle", "drag-single-shape")
def drag_in_a_direction(see: Sight) -> Action:
    shape = shapes(see)[0]
    across, down = STEPS[see.words(r"Drag the \w+ (\w+) then")]
    if see.page.tampered[shape]:
        return see.press_button("Submit")
    return see.drag(shape, by=(30 * across, 30 * down))


@plays("drag-box")
def drag_the_box_inside(see: Sight) -> Action:
    small, large = see.row("div", "s"), see.row("div", "L")
    if _inside(see, small, large):
        return see.press_button("Submit")
    return see.drag(small, to=large)


def _inside(see: Sight, row: int, box: int) -> bool:
    x, y = see.centre(row)
    left, top, width, height = (float(each) for each in see.page.box[box])
    return left < x < left + width and top < y < top + height


def _boxes(see: Sight) -> list[int]:
    return [row for row in see.rows("rect") if see.page.colour[row] == "none"]


@plays("drag-shapes")
def drag_shapes_into_the_box(see: Sight) -> Action:
    wanted = see.words(r"Drag all (\w+)s into")
    return _sort_into(see, {row: _boxes(see)[0] for row in _loose(see) if kind(see, row) == wanted})


@plays("drag-shapes-2")
def drag_shapes_into_two_boxes(see: Sight) -> Action:
    wanted = see.words(r"Drag all (\w+?)(?:s| shapes) into")
    left, right = _boxes(see)
    loose = _loose(see)
    return _sort_into(see, {row: left if wanted in (kind(see, row), see.page.colour[row]) else right for row in loose})


def _loose(see: Sight) -> list[int]:
    boxes = set(_boxes(see))
    return [row for row in shapes(see) if row not in boxes]


def _sort_into(see: Sight, boxes: dict[int, int]) -> Action:
    for row, box in boxes.items():
        if not _inside(see, row, box):
            return see.drag(row, to=box)
    return see.press_button("Submit")


@plays("drag-items")
def drag_the_item(see: Sight) -> Action:
    items = see.rows("li")
    names = [see.reading(item) for item in items]
    name, where = re.findall(r"Drag (.+?) (?:to the |)(top|bottom|up|down|\d+\w\w)\b", see.said)[0]
    start = names.index(name)
    places = {"top": 0, "bottom": len(items) - 1, "up": start - 1, "down": start + 1}
    end = places[where] if where in places else int(where[:-2]) - 1
    return _reorder(see, items, start, end)


@plays("drag-items-grid")
def drag_the_tile(see: Sight) -> Action:
    items = see.rows("li")
    name, where = re.findall(r"Drag (.+?) (?:to the (.+)|\w+ by one)\.$", see.said)[0]
    start = [see.reading(item) for item in items].index(name)
    if where:
        return see.drag(items[start], to=items[PLACES.index(where)])
    across, down = STEPS[see.words(r"(\w+) by one")]
    return see.drag(items[start], to=items[start + int(across) + 3 * int(down)])


@plays("drag-sort-numbers")
def sort_the_numbers(see: Sight) -> Action:
    items = see.rows("li")
    numbers = [int(see.reading(item)) for item in items]
    for place, number in enumerate(sorted(numbers)):
        if numbers[place] != number:
            return _reorder(see, items, numbers.index(number, place), place)
    return see.press_button("Submit")


def _reorder(see: Sight, items: list[int], start: int, end: int) -> Action:
    """Drop an item of a list a little past the middle of the one whose place it takes."""
    return see.drag(items[start], to=items[end], by=(0.0, 4.0 if end > start else -4.0))


@plays("resize-textarea")
def resize_the_field(see: Sight) -> Action:
    area = see.row("textarea")
    across, larger = "width" in see.said, "larger" in see.said
    grip = see.row(kind="ui-resizable-e" if across else "ui-resizable-s")
    if see.page.tampered[grip]:
        return see.press_button("Submit")
    change = 15.0 if larger else -15.0
    del area
    return see.drag(grip, by=(change, 0.0) if across else (0.0, change))


@plays("draw-line")
def draw_through_the_dot(see: Sight) -> Action:
    if see.rows("path"):
        return see.press_button("Submit")
    across, down = STEPS["right" if "horizontal" in see.said else "down"]
    dot = see.row("circle")
    return see.drag(dot, at=(-24 * across, -24 * down), by=(48 * across, 48 * down))


@plays("highlight-text", "highlight-text-2")
def select_the_text(see: Sight) -> Action:
    nth = re.search(ORDINAL, see.said)
    texts = see.rows("p") or [row for row in see.rows("div") if see.page.text[row]]
    text = texts[int(nth[1]) - 1 if nth else 0]
    if see.page.tampered[text]:
        return see.press_button("Submit")
    _, _, width, height = (float(each) for each in see.page.box[text])
    return see.drag(text, at=(-width / 2, 1 - height / 2), by=(width, height - 2))


@plays("scroll-text-2")
def scroll_the_text(see: Sight) -> Action:
    area = see.row("textarea")
    if see.page.tampered[area]:
        return see.press_button("Submit")
    return see.scroll(area, -5000.0 if "top" in see.said else 5000.0)


@plays("sign-agreement")
def sign_or_cancel(see: Sight) -> Action:
    if not see.quoted():
        return see.press_button("Cancel")
    name, button = see.quoted()
    area = see.row("textarea")
    if not see.page.tampered[area]:
        return see.scroll(area, 5000.0)
    return see.fill({see.row("input_text"): name}) or see.press_button(button)


@plays("use-slider")
def slide_to_the_number(see: Sight) -> Action:
    return _slide(see, see.rows("span", kind="ui-slider-handle"), [int(see.words(r"Select (-?\d+) with"))])


@plays("use-slider-2")
def slide_three(see: Sight) -> Action:
    wanted = [int(number) for number in see.words(r"\[(.+)\]").split(",")]
    return _slide(see, see.rows("span", kind="ui-slider-handle"), wanted)


@plays("form-sequence")
def slide_and_check(see: Sight) -> Action:
    box = see.rows("input_checkbox")[int(see.words(ORDINAL)) - 1]
    if see.page.value[box] != "checked":
        return see.click(box)
    return slide_to_the_number(see)


def _slide(see: Sight, handles: list[int], wanted: list[int]) -> Action:
    """Press arrows in the handles until the numbers beside them are right, then submit."""
    shown = [int(text) for text in see.page.text if re.fullmatch(r"-?\d+", text)]
    for handle, now, goal in zip(handles, shown, wanted, strict=True):
        if now != goal:
            return see.press("ArrowRight" if goal > now else "ArrowLeft", handle)
    return see.press_button("Submit")
