"""Which words of an instruction stand for what a field was made to hold."""

from __future__ import annotations

import pytest

from browser_farm.human.spans import wording
from giirl_core.types import NO_SPAN, Goal


@pytest.mark.parametrize(
    ("utterance", "held", "words"),
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
def test_what_a_field_holds_is_copied_from_the_words_that_stand_for_it(utterance: str, held: str, words: str) -> None:
    goal = Goal(utterance)
    assert goal.span(*wording(goal, held)) == words


@pytest.mark.parametrize("held", ["2019-08-02", "Rus", "russo from", "07:16", ""])
def test_words_that_only_resemble_what_a_field_holds_do_not_stand_for_it(held: str) -> None:
    assert wording(Goal("Enter 02/08/2019, 7:16 PM and Russo."), held) == (NO_SPAN, NO_SPAN)
