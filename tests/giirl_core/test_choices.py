"""Gestures and choices: what the nets choose from, read from demonstrations and from text."""

from __future__ import annotations

import numpy as np
import pytest

from giirl_core.choices import SampledActions, action_of, choice_of, shown_gestures
from giirl_core.gestures import BASIC, CLICK, MAX_GESTURES, TYPE_WORDS, read_gesture, read_gestures
from giirl_core.types import Action, Verb
from tests.learner.samples import page

FORM = page("div", "input_text", "button:Send", "t:Ada", parent=(-1, 0, 0, 0))
TEXTS = [
    "click",
    "type words",
    "type text-of",
    'type "yes, I do"',
    'type "at 3 4"',
    r'type "a \"b\" ü"',
    "append words",
    "hover",
    "wait",
    "press Enter",
    "press Control+c",
    "scroll by 0 -100",
    "click at 10 -5",
    "drag by 30 0",
    "drag to",
    "drag to by 0 5",
    "drag at -25 0 by 50 1",
    "drag across",
    "double_click",
]


@pytest.mark.parametrize("text", TEXTS)
def test_a_gesture_is_read_from_its_text(text: str) -> None:
    assert str(read_gesture(text)) == text


@pytest.mark.parametrize(
    "text",
    ["", "jump", "click words", "press", "press Nokey", "hover to", "click across", "type words at 1 1", "drag by 1"],
)
def test_a_text_that_is_no_gesture_is_one_clear_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"is no gesture: wanted one such as") as caught:
        read_gesture(text)
    assert "\n" not in str(caught.value)


def test_every_run_has_the_basic_gestures_first() -> None:
    assert read_gestures([]) == BASIC == (CLICK, TYPE_WORDS)
    assert read_gestures(["hover", "click", "shown"]) == (*BASIC, read_gesture("hover"))
    with pytest.raises(ValueError, match=f"wanted at most {MAX_GESTURES}"):
        read_gestures([f"scroll by 0 {n}" for n in range(1, MAX_GESTURES)])


@pytest.mark.parametrize(
    ("action", "text"),
    [
        (Action(verb=Verb.CLICK, element=2), "click"),
        (Action(verb=Verb.TYPE, element=1, start=0, end=1), "type words"),
        (Action(verb=Verb.TYPE, element=1, literal="Ada"), "type text-of"),
        (Action(verb=Verb.TYPE, element=1, literal="no"), 'type "no"'),
        (Action(verb=Verb.PRESS, element=1, literal="Tab"), "press Tab"),
        (Action(verb=Verb.SCROLL, element=0, by=(0.0, 470.0)), "scroll by 0 500"),
        (Action(verb=Verb.DRAG, element=2, to=3, by=(0.0, -4.0)), "drag to by 0 -5"),
        (Action(verb=Verb.DRAG, element=2, at=(-5.0, -5.0), by=(9.0, 10.0)), "drag across"),
        (Action(verb=Verb.WAIT), "wait"),
    ],
)
def test_an_action_is_the_gesture_with_the_nearest_distances(action: Action, text: str) -> None:
    gestures = read_gestures([*TEXTS, text])
    choice = choice_of(action, FORM, gestures)
    assert choice is not None
    assert str(gestures[choice.gesture]) == text
    again = action_of(choice, FORM, gestures)
    assert (again.verb, again.element, again.literal, again.to) == (
        action.verb,
        action.element,
        action.literal,
        action.to,
    )
    assert choice_of(again, FORM, gestures) == choice


@pytest.mark.parametrize(
    "action",
    [
        Action(verb=Verb.PRESS, literal="Enter"),  # on no element
        Action(verb=Verb.MOUSE_DOWN, element=2),  # not among the gestures
    ],
)
def test_an_action_that_is_no_gesture_has_no_choice(action: Action) -> None:
    assert choice_of(action, FORM, read_gestures(TEXTS)) is None


def test_what_three_demonstrations_show_is_a_gesture() -> None:
    hover, press = Action(verb=Verb.HOVER, element=2), Action(verb=Verb.PRESS, element=1, literal="Enter")
    click = Action(verb=Verb.CLICK, element=2)
    two, three = [(hover, FORM), (hover, FORM), (click, FORM)], [(press, FORM)]
    assert shown_gestures([two, two, three, three, three]) == ("press Enter",)
    assert shown_gestures([two, two, two, three, three, three, three]) == ("press Enter", "hover")


def test_of_distances_that_all_differ_the_most_frequent_stands_for_its_kind() -> None:
    scrolls = [[(Action(verb=Verb.SCROLL, element=0, by=(0.0, px)), FORM)] for px in (98.0, 105.0, 480.0, 2100.0)]
    assert shown_gestures(scrolls) == ("scroll by 0 100",)
    assert shown_gestures(scrolls[1:3]) == ()


def sampled(*rows: tuple[int, int, int, int]) -> SampledActions:
    choices = np.array([rows], dtype=np.int16)
    zeros = np.zeros(choices.shape[:2], dtype=np.float32)
    return SampledActions(choices=choices, logp=zeros, rewards=zeros)


GESTURES = (*BASIC, read_gesture("hover"), read_gesture("drag to"))
LEGAL = [(0, 2, -1, -1), (1, 1, 0, 1), (2, 3, -1, -1), (3, 0, 3, -1)]


def test_sampled_actions_that_exist_are_accepted() -> None:
    sampled(*LEGAL).check([len(FORM)], 2, GESTURES)


@pytest.mark.parametrize(
    "row",
    [
        (4, 0, -1, -1),  # no such gesture
        (-1, 0, -1, -1),
        (0, 4, -1, -1),  # no such element
        (0, -1, -1, -1),
        (0, 2, 0, 0),  # a click with words
        (1, 1, 1, 0),  # words that end before they begin
        (1, 1, 0, 2),  # more words than there are
        (1, 1, -1, -1),  # no words
        (2, 1, 0, -1),  # a hover with a second element
        (3, 0, 4, -1),  # no such second element
        (3, 0, -1, -1),  # no second element
        (3, 0, 1, 1),
    ],
)
def test_a_sampled_action_that_does_not_exist_is_an_error(row: tuple[int, int, int, int]) -> None:
    with pytest.raises(ValueError, match=r"sampled action 4 of step 0 is "):
        sampled(*LEGAL, row).check([len(FORM)], 2, GESTURES)
