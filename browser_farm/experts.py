"""Scripted players that are right every time: they make demonstrations and show that the browser works."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable

import numpy as np

from giirl.spec import Action, Observation, Verb

Expert = Callable[[Observation], Action]

QUOTED = re.compile(r'"([^"]*)"')
NAMED_BUTTON = re.compile(r"button (\w+)\.")


def expert(task: str) -> Expert:
    """The scripted player of a task; it sees what a policy sees and nothing else."""
    if task not in EXPERTS:
        near = difflib.get_close_matches(task, EXPERTS, n=1, cutoff=0.0)[0]
        raise ValueError(
            f"there is no scripted expert for task {task!r}: did you mean {near!r}? ({', '.join(EXPERTS)})"
        )
    return EXPERTS[task]


def _click_the_button(observation: Observation) -> Action:
    return Action(verb=Verb.CLICK, element=observation.page.tag.index("button"))


def _click_the_named_button(observation: Observation) -> Action:
    return _click(observation, _said(NAMED_BUTTON, observation))


def _click_the_quoted_button(observation: Observation) -> Action:
    return _click(observation, _said(QUOTED, observation))


def _enter_the_quoted_text(observation: Observation) -> Action:
    wanted = _said(QUOTED, observation)
    field = int(np.flatnonzero(observation.page.typable)[0])
    if observation.page.value[field] == wanted:
        return _click(observation, "Submit")
    start, end = observation.goal.find(wanted)
    return Action(verb=Verb.TYPE, element=field, start=start, end=end)


def _said(pattern: re.Pattern[str], observation: Observation) -> str:
    match = pattern.search(observation.goal.utterance)
    if match is None:
        raise ValueError(f"the instruction {observation.goal.utterance!r} does not read like {pattern.pattern}")
    return match.group(1)


def _click(observation: Observation, name: str) -> Action:
    """Click the button that reads exactly `name`."""
    page = observation.page
    for row, (tag, text) in enumerate(zip(page.tag, page.text, strict=True)):
        if tag == "button" and text == name:
            return Action(verb=Verb.CLICK, element=row)
    raise ValueError(f"no button reads {name!r} on the page of {observation.episode}")


EXPERTS: dict[str, Expert] = {
    "click-test": _click_the_button,
    "click-test-2": _click_the_named_button,
    "click-button": _click_the_quoted_button,
    "enter-text": _enter_the_quoted_text,
}
