"""Which words of an instruction have the same effect as the value of a field."""

from __future__ import annotations

import pytest

from browser_farm.human.spans import equivalent_span
from giirl_core.types import NO_SPAN, Goal


@pytest.mark.parametrize(
    ("utterance", "value", "words"),
    [
        ("Enter 02/08/2019 as the date.", "2019-02-08", "02/08/2019"),
        ("Enter 7:16 PM as the time.", "19:16", "7:16 PM"),
        ("Enter 12:05 AM as the time.", "00:05", "12:05 AM"),
        ("Enter 11:12 AM as the time.", "11:12", "11:12 AM"),
        ("Enter 9:05 as the time.", "09:05", "9:05"),
        ("Search for movies by Russo from 1974.", "russo ", "Russo"),
        ("Choose ok or Ok.", "Ok", "Ok"),
    ],
)
def test_a_field_value_matches_the_words_with_the_same_effect(utterance: str, value: str, words: str) -> None:
    goal = Goal(utterance)
    assert goal.span(*equivalent_span(goal, value)) == words


@pytest.mark.parametrize("value", ["2019-08-02", "Rus", "russo from", "07:16", ""])
def test_similar_words_do_not_match_a_field_value(value: str) -> None:
    assert equivalent_span(Goal("Enter 02/08/2019, 7:16 PM and Russo."), value) == (NO_SPAN, NO_SPAN)
