"""Pages with drawings: shapes, colours, sides, points of a grid."""

from __future__ import annotations

import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

LARGE_PX = 15  # taller is large
KINDS = {"rect": "rectangle", "circle": "circle", "polygon": "triangle"}
SIDES = {"triangle": "3", "quadrilateral": "4", "pentagon": "5", "hexagon": "6", "heptagon": "7"}


def shapes(see: PageView) -> list[int]:
    """What is drawn."""
    return [row for row in see.page.descendants(see.row("svg")) if see.page.tag[row] in ("text", *KINDS)]


def kind(see: PageView, row: int) -> str:
    """What a shape is called: its form, or the character that it is."""
    return see.page.text[row] or KINDS[see.page.tag[row]]


def _fits(see: PageView, row: int, description: str) -> bool:
    """Whether a shape is such a "large red digit", any word of which may be missing."""
    size = "large" if see.page.box[row, 3] > LARGE_PX else "small"
    name = kind(see, row)
    genus = "shape" if len(name) > 1 else "digit" if name.isdigit() else "letter"
    return set(description.split()) <= {size, see.page.colour[row], name, genus, "item"}


@expert_for("click-shape")
def click_the_described(see: PageView) -> Action:
    description = see.words(r"Click on an? (.+)$")
    return see.click(next(row for row in shapes(see) if _fits(see, row, description)))


@expert_for("count-shape")
def count_the_described(see: PageView) -> Action:
    description = see.words(r"How many (.+)s are there")
    return see.press_button(str(sum(_fits(see, row, description) for row in shapes(see))))


@expert_for("identify-shape")
def name_the_shape(see: PageView) -> Action:
    name = kind(see, shapes(see)[0])
    genus = name if len(name) > 1 else "number" if name.isdigit() else "letter"
    return see.press_button(genus.capitalize())


@expert_for("count-sides")
def count_the_sides(see: PageView) -> Action:
    return see.press_button(SIDES[see.page.shape[see.row("canvas")].split()[0]])


@expert_for("grid-coordinate")
def click_the_coordinate(see: PageView) -> Action:
    x, y = int(see.words(r"\((-?\d+),")), int(see.words(r",(-?\d+)\)"))
    points = see.rows("circle")
    columns = sorted({float(see.page.box[row, 0]) for row in points})
    lines = sorted({float(see.page.box[row, 1]) for row in points}, reverse=True)
    here = (columns[x + 2], lines[y + 2])
    return see.click(next(row for row in points if (see.page.box[row, 0], see.page.box[row, 1]) == here))


@expert_for("click-color")
def click_the_colour(see: PageView) -> Action:
    wanted = see.words(r"Click on the (\w+) colored")
    return see.click(next(row for row in see.rows(kind="color") if see.page.colour[row] == wanted))


@expert_for("click-shades")
def click_all_shades(see: PageView) -> Action:
    wanted = ("red", "green", "blue").index(see.words(r"shades of (\w+)"))
    for row in see.rows("span"):
        shade = [int(part) for part in re.findall(r"\d+", see.page.colour[row])]
        if (shade.index(max(shade)) == wanted) != see.has(row, "selected"):
            return see.click(row)
    return see.press_button("Submit")


@expert_for("ascending-numbers")
def click_in_order(see: PageView) -> Action:
    """The numbers are covered after the first click; the covers lie in their order."""
    numbers = see.rows("text", "1")
    return see.click(numbers[0] if numbers else see.row("rect"))
