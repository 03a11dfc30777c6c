"""Finds the span of an instruction that a policy can type to give a field the value that the person gave it."""

from __future__ import annotations

import re
from collections.abc import Iterator

from giirl_core.types import NO_SPAN, TOKEN, Goal

DATE = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{4})")
TIME = re.compile(r"(\d{1,2}):(\d{2})(?: ([AP])M)?")


def equivalent_span(goal: Goal, value: str) -> tuple[int, int]:
    """First and last token of the words that have the same effect as `value` when typed; (-1, -1) if there are none.

    Only for successful episodes: there the page accepted the value, so different case is allowed, and a date or time
    of the instruction matches the format in which date and time fields store it ("7:16 PM" matches "19:16").
    """
    written = [words for words, stored in _dates_and_times(goal.utterance) if stored == value]
    for text in (*written, value):  # dates and times first: "11:12" is also the beginning of "11:12 AM"
        span = goal.find(text)
        if span[0] != NO_SPAN:
            return span
    wanted = TOKEN.findall(value.casefold())
    tokens = [token.casefold() for token in goal.tokens]
    for start in range(len(tokens) - len(wanted) + 1):
        end = start + len(wanted) - 1
        same_tokens = wanted and tokens[start : end + 1] == wanted
        if same_tokens and goal.span(start, end).casefold() == value.casefold().strip():
            return start, end
    return NO_SPAN, NO_SPAN


def _dates_and_times(utterance: str) -> Iterator[tuple[str, str]]:
    """Every date and time of an instruction: as written there, and as a date or time field stores it."""
    for found in DATE.finditer(utterance):
        month, day, year = found.groups()
        yield found.group(), f"{year}-{int(month):02}-{int(day):02}"
    for found in TIME.finditer(utterance):
        hour, minute, half = found.groups()
        hour_24 = int(hour) % 12 + (12 if half == "P" else 0) if half else int(hour)
        yield found.group(), f"{hour_24:02}:{minute}"
