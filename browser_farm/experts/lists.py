"""Pages where several things are chosen and then submitted: boxes, options, rows of buttons."""

from __future__ import annotations

import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

SYNONYMS = tuple(
    set(line.split())
    for line in """
    big large huge enormous gigantic
    small tiny little mini petite
    red scarlet crimson vermillion
    happy cheerful joyful gleeful delighted
    sad unhappy sorrowful miserable tragic
    angry mad furious irritated
    evil wicked immoral sinful corrupt depraved
    wrong incorrect mistaken erroneous
    real genuine actual
    strange odd peculiar unusual weird
    stop cease halt end finish
    scared terrified panicked fearful frightened afraid
    quiet calm peaceful serene mild
    old aged archaic
    love like adore favor
    kill murder assassinate
    keep retain preserve sustain maintain
    hide conceal camouflage
    hate despise loathe detest dislike
    funny humorous amusing comical laughable
    fat fleshy plump chubby
    stupid dumb dull unwise
    delicious savory delectable appetizing
    cut slice carve chop
    brave courageous fearless
    begin start initiate launch
    answer reply response
    television televisions TV TVs
    house home houses homes
    fire flame fires flames
    pig pork swine
    rabbit rabbits bunny bunnies
    car cars automobile automobiles vehicle vehicles
    water
    """.strip().splitlines()
)
SERVED = {  # what a reader of the menu sees in the pictures beside a dish
    "dairy": "Spinach and goat cheese dip",
    "gluten-free": "Caesar Salad",
    "meat": "Chicken wings",
    "peanuts": "Spicy Thai Peanut Chicken",
    "vegan": "Garlic bread",
}
DIGITS = (  # rows of four boxes from the top, 8 4 2 1
    (6, 9, 9, 9, 9, 9, 6),
    (2, 6, 2, 2, 2, 2, 2),
    (6, 9, 9, 2, 4, 8, 15),
    (6, 9, 1, 6, 1, 9, 6),
    (8, 10, 10, 15, 2, 2, 2),
    (15, 8, 8, 14, 1, 9, 6),
    (6, 9, 8, 14, 9, 9, 6),
    (15, 9, 1, 2, 2, 4, 4),
    (6, 9, 9, 6, 9, 9, 6),
    (6, 9, 9, 7, 1, 9, 6),
)


def _box_beside(see: PageView, label: int) -> int:
    return next(row for row in see.page.descendants(label) if see.page.tag[row] in ("input_checkbox", "input_radio"))


def _check(see: PageView, wanted: set[str]) -> Action:
    """Make the labelled boxes that are checked the wanted ones, then submit."""
    for label in see.rows("label"):
        box = _box_beside(see, label)
        if (see.page.value[box] == "checked") != (see.reading(label) in wanted):
            return see.click(box)
    return see.press_button("Submit")


@expert_for("click-checkboxes", "click-checkboxes-large", "click-checkboxes-transfer", "click-option")
def check_the_named(see: PageView) -> Action:
    names = see.words(r"Select (.+) and click Submit")
    return _check(see, set() if names == "nothing" else set(names.split(", ")))


@expert_for("click-checkboxes-soft")
def check_the_similar(see: PageView) -> Action:
    named = see.words(r"similar to (.+) and click Submit").split(", ")
    return _check(see, set().union(*(group for group in SYNONYMS if group & set(named))))


@expert_for("number-checkboxes")
def draw_a_digit(see: PageView) -> Action:
    wanted = [bool(line & bit) for line in DIGITS[int(see.quoted()[0])] for bit in (8, 4, 2, 1)]
    for box, on in zip(see.rows("input_checkbox"), wanted, strict=True):
        if (see.page.value[box] == "checked") != on:
            return see.click(box)
    return see.press_button("Submit")


@expert_for("choose-list", "click-scroll-list")
def choose_from_the_list(see: PageView) -> Action:
    for name in see.words(r"Select (.+) from the (?:scroll )?list").split(", "):
        option = see.row("option", name)
        if see.page.value[option] != "checked":
            return see.click(option)
    return see.press_button("Submit")


@expert_for("odd-or-even")
def mark_odd_and_even(see: PageView) -> Action:
    for row in see.rows("div", kind="row"):
        number = int(see.page.text[see.row("div", kind="display-number", inside=row)])
        button = see.row("button", kind="odd" if number % 2 else "even", inside=row)
        if not see.has(button, "selected"):
            return see.click(button)
    return see.press_button("Submit")


@expert_for("order-food")
def order_the_dishes(see: PageView) -> Action:
    dishes = {see.page.text[row]: see.above(row, kind="food-item") for row in see.rows(kind="item-name")}
    kind = re.search(r"Order (\d+) items that are (\S+)", see.said)
    if kind is None:
        wanted = dict.fromkeys(see.words(r"Order one of each item: (.+)").split(", "), 1)
    else:
        wanted = {SERVED[kind[2]]: int(kind[1])}
    for name, amount in wanted.items():
        item = dishes[name.strip()]
        shown = [see.page.text[row] for row in see.rows(kind="quantity", inside=item)]
        if int("".join(shown) or 0) < amount:
            return see.click(see.row(kind="add", inside=item))
    return see.press_button("Order!")


@expert_for("buy-ticket")
def buy_the_best_ticket(see: PageView) -> Action:
    wanted = see.words(r"with the (\w+ \w+(?: \w+)?)\.")
    flights = see.rows(kind="flight")

    def price(flight: int) -> int:
        return int(see.page.text[see.row("button", inside=flight)].partition("$")[2])

    def minutes(flight: int) -> int:
        hours, rest = re.findall(r"\d+", see.page.text[see.row(kind="time-duration", inside=flight)])
        return 60 * int(hours) + int(rest)

    least = wanted in ("cheapest cost", "shortest duration")
    best = (min if least else max)(flights, key=price if wanted.endswith("cost") else minutes)
    return see.click(see.row("button", inside=best))


@expert_for("phone-book")
def find_the_contact(see: PageView) -> Action:
    name, what = see.words(r"Find (.+) in the"), see.words(r"click on their (\w+)")
    if see.page.text[see.row(kind="name")] == name:
        return see.click(see.row("a", kind=what))
    return see.click(see.row("a", ">"))
