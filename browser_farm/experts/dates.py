"""Experts for tasks with a date picker, and for booking flights."""

from __future__ import annotations

import calendar
import re

from browser_farm.experts.forms import click_suggestion
from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

MONTHS = list(calendar.month_name)


@expert_for("choose-date", "choose-date-easy", "choose-date-medium", "choose-date-nodelay")
def choose_the_date(view: PageView) -> Action:
    date = view.extract(r"Select (\S+) as")
    return pick_date(view, view.row("input_text"), date) or view.click_button("Submit")


def pick_date(view: PageView, field: int, date: str) -> Action | None:
    """Open the date picker of a field, go to the month and click the day. None if the field has the date already.

    `date` is MM/DD/YYYY.
    """
    if view.page.value[field] == date:
        return None
    month_titles = view.rows("span", css_class="ui-datepicker-month")
    if not month_titles:
        return view.click(field)
    month, day, _ = (int(part) for part in date.split("/"))
    shown = MONTHS.index(view.page.text[month_titles[0]])
    if shown != month:
        arrow = view.row("a", css_class="ui-datepicker-prev" if shown > month else "ui-datepicker-next")
        return view.click(view.first_leaf(arrow))
    return view.click(view.row("a", str(day), "ui-state-default"))


@expert_for("book-flight", "book-flight-nodelay")
def book_the_best_flight(view: PageView) -> Action:
    flights = view.rows(css_class="flight")
    if flights:
        key = _price if "cheapest" in view.instruction else _minutes
        return view.click(view.row("button", inside=min(flights, key=lambda flight: key(view, flight))))
    start, end, date = re.findall(r"from: (.+) to: (.+) on (\S+)\.$", view.instruction)[0]
    origin, destination, day = view.rows("input_text", css_class="flight-input")
    action = _enter_airport(view, origin, start) or _enter_airport(view, destination, end) or pick_date(view, day, date)
    return action or view.click_button("Search")


def _enter_airport(view: PageView, field: int, place: str) -> Action | None:
    """Type the place and click the suggestion with it. None if the field has the suggestion already."""
    value = view.page.value[field]
    if place in value and value.endswith(")"):
        return None
    return view.fill({field: place}) or click_suggestion(view, lambda name: place in name)


def _price(view: PageView, flight: int) -> int:
    return int(view.page.text[view.row("button", inside=flight)].partition("$")[2])


def _minutes(view: PageView, flight: int) -> int:
    hours, minutes = re.findall(r"\d+", view.page.text[view.row(css_class="time-duration", inside=flight)])
    return 60 * int(hours) + int(minutes)
