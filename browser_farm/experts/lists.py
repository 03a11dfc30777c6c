"""Experts for tasks with several choices before Submit: checkboxes, options, rows of buttons."""

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
DISHES = {  # diet -> the dish whose icons on the menu show it
    "dairy": "Spinach and goat cheese dip",
    "gluten-free": "Caesar Salad",
    "meat": "Chicken wings",
    "peanuts": "Spicy Thai Peanut Chicken",
    "vegan": "Garlic bread",
}
DIGITS = (  # seven rows of four checkboxes from the top, as bits 8 4 2 1
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


def _checkbox_of(view: PageView, label: int) -> int:
    return next(row for row in view.page.descendants(label) if view.page.tag[row] in ("input_checkbox", "input_radio"))


def _check(view: PageView, wanted: set[str]) -> Action:
    """Check exactly the checkboxes whose labels are wanted, then submit."""
    for label in view.rows("label"):
        box = _checkbox_of(view, label)
        if (view.page.value[box] == "checked") != (view.all_text(label) in wanted):
            return view.click(box)
    return view.click_button("Submit")


@expert_for("click-checkboxes", "click-checkboxes-large", "click-checkboxes-transfer", "click-option")
def check_the_named(view: PageView) -> Action:
    names = view.extract(r"Select (.+) and click Submit")
    return _check(view, set() if names == "nothing" else set(names.split(", ")))


@expert_for("click-checkboxes-soft")
def check_the_similar(view: PageView) -> Action:
    named = view.extract(r"similar to (.+) and click Submit").split(", ")
    return _check(view, set().union(*(group for group in SYNONYMS if group & set(named))))


@expert_for("number-checkboxes")
def draw_a_digit(view: PageView) -> Action:
    wanted = [bool(line & bit) for line in DIGITS[int(view.quoted()[0])] for bit in (8, 4, 2, 1)]
    for box, on in zip(view.rows("input_checkbox"), wanted, strict=True):
        if (view.page.value[box] == "checked") != on:
            return view.click(box)
    return view.click_button("Submit")


@expert_for("choose-list", "click-scroll-list")
def choose_from_the_list(view: PageView) -> Action:
    for name in view.extract(r"Select (.+) from the (?:scroll )?list").split(", "):
        option = view.row("option", name)
        if view.page.value[option] != "checked":
            return view.click(option)
    return view.click_button("Submit")


@expert_for("odd-or-even")
def mark_odd_and_even(view: PageView) -> Action:
    for row in view.rows("div", css_class="row"):
        number = int(view.page.text[view.row("div", css_class="display-number", inside=row)])
        button = view.row("button", css_class="odd" if number % 2 else "even", inside=row)
        if not view.has_class(button, "selected"):
            return view.click(button)
    return view.click_button("Submit")


@expert_for("order-food")
def order_the_dishes(view: PageView) -> Action:
    names = view.rows(css_class="item-name")
    dishes = {view.page.text[row]: view.ancestor(row, css_class="food-item") for row in names}
    diet = re.search(r"Order (\d+) items that are (\S+)", view.instruction)
    if diet is None:
        wanted = dict.fromkeys(view.extract(r"Order one of each item: (.+)").split(", "), 1)
    else:
        wanted = {DISHES[diet[2]]: int(diet[1])}
    for name, amount in wanted.items():
        item = dishes[name.strip()]
        shown = [view.page.text[row] for row in view.rows(css_class="quantity", inside=item)]
        if int("".join(shown) or 0) < amount:
            return view.click(view.row(css_class="add", inside=item))
    return view.click_button("Order!")


@expert_for("buy-ticket")
def buy_the_best_ticket(view: PageView) -> Action:
    wanted = view.extract(r"with the (\w+ \w+(?: \w+)?)\.")
    flights = view.rows(css_class="flight")

    def price(flight: int) -> int:
        return int(view.page.text[view.row("button", inside=flight)].partition("$")[2])

    def minutes(flight: int) -> int:
        hours, rest = re.findall(r"\d+", view.page.text[view.row(css_class="time-duration", inside=flight)])
        return 60 * int(hours) + int(rest)

    least = wanted in ("cheapest cost", "shortest duration")
    best = (min if least else max)(flights, key=price if wanted.endswith("cost") else minutes)
    return view.click(view.row("button", inside=best))


@expert_for("phone-book")
def find_the_contact(view: PageView) -> Action:
    name, what = view.extract(r"Find (.+) in the"), view.extract(r"click on their (\w+)")
    if view.page.text[view.row(css_class="name")] == name:
        return view.click(view.row("a", css_class=what))
    return view.click(view.row("a", ">"))
