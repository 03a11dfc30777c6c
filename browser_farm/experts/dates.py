"""Calendars, and the flights that are booked with them."""

from __future__ import annotations

import calendar
import re

from browser_farm.experts.forms import take_suggestion
from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

MONTHS = list(calendar.month_name)


@expert_for("choose-date", "choose-date-easy", "choose-date-medium", "choose-date-nodelay")
def choose_the_date(see: PageView) -> Action:
    date = see.words(r"Select (\S+) as")
    return pick_date(see, see.row("input_text"), date) or see.press_button("Submit")


def pick_date(see: PageView, field: int, date: str) -> Action | None:
    """Open the calendar of a field, turn to the month and click the day; None when the field holds the date."""
    if see.page.value[field] == date:
        return None
    shown = see.rows("span", kind="ui-datepicker-month")
    if not shown:
        return see.click(field)
    month, day, _ = (int(part) for part in date.split("/"))
    here = MONTHS.index(see.page.text[shown[0]])
    if here != month:
        arrow = see.row("a", kind="ui-datepicker-prev" if here > month else "ui-datepicker-next")
        return see.click(see.leaf(arrow))
    return see.click(see.row("a", str(day), "ui-state-default"))


@expert_for("book-flight", "book-flight-nodelay")
def book_the_best_flight(see: PageView) -> Action:
    flights = see.rows(kind="flight")
    if flights:
        key = _price if "cheapest" in see.said else _minutes
        return see.click(see.row("button", inside=min(flights, key=lambda flight: key(see, flight))))
    start, end, date = re.findall(r"from: (.+) to: (.+) on (\S+)\.$", see.said)[0]
    origin, destination, day = see.rows("input_text", kind="flight-input")
    action = _fly(see, origin, start) or _fly(see, destination, end) or pick_date(see, day, date)
    return action or see.press_button("Search")


def _fly(see: PageView, field: int, place: str) -> Action | None:
    """Type the place and take the suggestion that has it; None when it was taken."""
    value = see.page.value[field]
    if place in value and value.endswith(")"):
        return None
    return see.fill({field: place}) or take_suggestion(see, lambda name: place in name)


def _price(see: PageView, flight: int) -> int:
    return int(see.page.text[see.row("button", inside=flight)].partition("$")[2])


def _minutes(see: PageView, flight: int) -> int:
    hours, minutes = re.findall(r"\d+", see.page.text[see.row(kind="time-duration", inside=flight)])
    return 60 * int(hours) + int(minutes)
