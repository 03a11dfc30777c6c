"""Experts for tasks with drawings: shapes, colours, sides, points of a grid."""

from __future__ import annotations

import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

LARGE_PX = 15  # higher shapes are "large"
KINDS = {"rect": "rectangle", "circle": "circle", "polygon": "triangle"}
SIDES = {"triangle": "3", "quadrilateral": "4", "pentagon": "5", "hexagon": "6", "heptagon": "7"}


def shapes(view: PageView) -> list[int]:
    """The rows of the drawn shapes and characters."""
    return [row for row in view.page.descendants(view.row("svg")) if view.page.tag[row] in ("text", *KINDS)]


def shape_name(view: PageView, row: int) -> str:
    """The name of a shape, "rectangle" for example, or the character that is drawn."""
    return view.page.text[row] or KINDS[view.page.tag[row]]


def _fits(view: PageView, row: int, description: str) -> bool:
    """Whether a shape fits a description like "large red digit", of which each word is optional."""
    size = "large" if view.page.box[row, 3] > LARGE_PX else "small"
    name = shape_name(view, row)
    category = "shape" if len(name) > 1 else "digit" if name.isdigit() else "letter"
    return set(description.split()) <= {size, view.page.colour[row], name, category, "item"}


@expert_for("click-shape")
def click_the_described(view: PageView) -> Action:
    description = view.extract(r"Click on an? (.+)$")
    return view.click(next(row for row in shapes(view) if _fits(view, row, description)))


@expert_for("count-shape")
def count_the_described(view: PageView) -> Action:
    description = view.extract(r"How many (.+)s are there")
    return view.click_button(str(sum(_fits(view, row, description) for row in shapes(view))))


@expert_for("identify-shape")
def name_the_shape(view: PageView) -> Action:
    name = shape_name(view, shapes(view)[0])
    category = name if len(name) > 1 else "number" if name.isdigit() else "letter"
    return view.click_button(category.capitalize())


@expert_for("count-sides")
def count_the_sides(view: PageView) -> Action:
    return view.click_button(SIDES[view.page.shape[view.row("canvas")].split()[0]])


@expert_for("grid-coordinate")
def click_the_coordinate(view: PageView) -> Action:
    x, y = int(view.extract(r"\((-?\d+),")), int(view.extract(r",(-?\d+)\)"))
    points = view.rows("circle")
    columns = sorted({float(view.page.box[row, 0]) for row in points})
    lines = sorted({float(view.page.box[row, 1]) for row in points}, reverse=True)
    position = (columns[x + 2], lines[y + 2])
    return view.click(next(row for row in points if (view.page.box[row, 0], view.page.box[row, 1]) == position))


@expert_for("click-color")
def click_the_colour(view: PageView) -> Action:
    wanted = view.extract(r"Click on the (\w+) colored")
    return view.click(next(row for row in view.rows(css_class="color") if view.page.colour[row] == wanted))


@expert_for("click-shades")
def click_all_shades(view: PageView) -> Action:
    wanted = ("red", "green", "blue").index(view.extract(r"shades of (\w+)"))
    for row in view.rows("span"):
        shade = [int(part) for part in re.findall(r"\d+", view.page.colour[row])]
        if (shade.index(max(shade)) == wanted) != view.has_class(row, "selected"):
            return view.click(row)
    return view.click_button("Submit")


@expert_for("ascending-numbers")
def click_in_order(view: PageView) -> Action:
    """After the first click the numbers are covered. The covers are in ascending order of the numbers."""
    numbers = view.rows("text", "1")
    return view.click(numbers[0] if numbers else view.row("rect"))
