"""Finds the words of an instruction that stand for what a person made a field hold."""

from __future__ import annotations

import re
from collections.abc import Iterator

from giirl_core.types import NO_SPAN, TOKEN, Goal

DATE = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{4})")
CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?: ([AP])M)?")


def wording(goal: Goal, held: str) -> tuple[int, int]:
    """First and last token of the words that, typed, would have served like `held`; (-1, -1) when there are none.

    For what succeeded: the page then took these words for the same, in other letters or as the date or time of
    day that they name (which is how date and time fields keep them).
    """
    named = [words for words, kept in _moments(goal.utterance) if kept == held]
    for text in (*named, held):  # "11:12" is also the beginning of "11:12 AM"
        span = goal.find(text)
        if span[0] != NO_SPAN:
            return span
    wanted = TOKEN.findall(held.casefold())
    tokens = [token.casefold() for token in goal.tokens]
    for start in range(len(tokens) - len(wanted) + 1):
        end = start + len(wanted) - 1
        if wanted and tokens[start : end + 1] == wanted and goal.span(start, end).casefold() == held.casefold().strip():
            return start, end
    return NO_SPAN, NO_SPAN


def _moments(utterance: str) -> Iterator[tuple[str, str]]:
    """Every date and time of day in an instruction, as it is written there and as a field keeps it."""
    for found in DATE.finditer(utterance):
        month, day, year = found.groups()
        yield found.group(), f"{year}-{int(month):02}-{int(day):02}"
    for found in CLOCK.finditer(utterance):
        hour, minute, half = found.groups()
        since_midnight = int(hour) % 12 + (12 if half == "P" else 0) if half else int(hour)
        yield found.group(), f"{since_midnight:02}:{minute}"
