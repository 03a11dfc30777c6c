"""Which action of an agent of this project has the effect of a command."""

from __future__ import annotations

import numpy as np
import pytest

from browser_farm.gym.agent_action import agent_action
from giirl_core.types import Action, Command, Goal, Page, Verb

GOAL = Goal('Enter "Ada Lovelace" and press Ok.')
PAGE = Page(
    tag=("div", "input_text", "input_text", "button"),
    text=("", "", "", "Ok"),
    value=("", "", "Bob", ""),
    classes=("",) * 4,
    ref=np.array([4, 7, 8, 9], dtype=np.int32),
    parent=np.array([-1, 0, 0, 0], dtype=np.int16),
    box=np.array([[0, 0, 160, 160], [0, 0, 80, 20], [0, 20, 80, 20], [0, 40, 80, 20]], dtype=np.float32),
    focused=np.array([False, True, False, False]),
    tampered=np.zeros(4, dtype=np.bool_),
)
CLICK = Action(verb=Verb.CLICK, element=3)
TYPE = Action(verb=Verb.TYPE, element=1, start=2, end=3)


@pytest.mark.parametrize(
    ("command", "action"),
    [
        (Command(verb=Verb.ACTIVATE, ref=9), CLICK),
        (Command(verb=Verb.CLICK, at=(79, 41)), CLICK),
        (Command(verb=Verb.CLICK, at=(81, 41)), Action(verb=Verb.CLICK, element=0)),
        (Command(verb=Verb.ACTIVATE, ref=7, text="Ada Lovelace"), TYPE),
        (Command(verb=Verb.APPEND, text="Ada Lovelace"), TYPE),
    ],
)
def test_a_command_is_the_click_or_the_typing_of_an_agent(command: Command, action: Action) -> None:
    assert agent_action(command, PAGE, GOAL) == action


@pytest.mark.parametrize(
    "command",
    [
        Command(verb=Verb.WAIT),
        Command(verb=Verb.PRESS, text="Enter"),
        Command(verb=Verb.SCROLL, at=(9, 9), by=(0, 9)),
        Command(verb=Verb.ACTIVATE, ref=5),  # an element that agents do not see
        Command(verb=Verb.CLICK, at=(161, 5)),  # beside the page
        Command(verb=Verb.ACTIVATE, ref=7, text="Grace"),  # no words of the goal
        Command(verb=Verb.ACTIVATE, ref=8, text="Ada Lovelace"),  # behind what is in the field
        Command(verb=Verb.ACTIVATE, ref=9, text="Ada Lovelace"),  # no field
    ],
)
def test_a_command_that_no_agent_can_give_has_no_action(command: Command) -> None:
    assert agent_action(command, PAGE, GOAL) is None
