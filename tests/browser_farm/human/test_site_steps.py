"""Steps on own pages: messages that change a step, pages as an agent would have seen them, dialogs."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from browser_farm.human.site_steps import SiteSteps
from browser_farm.human.steps import episode_of
from browser_farm.sites.page import Dialog, decode
from giirl_core.gestures import BASIC
from giirl_core.types import EpisodeSpec, Goal, Outcome, Page, Verb

SCALE = 0.5
SPEC = EpisodeSpec(task="orders.toml", seed=3)
GOAL = Goal('Order for "Ada" by 02/08/2024.')
DOCUMENT = 7
ROWS = [("input_text", "Name", 1, -1), ("select", "Size", 2, -1), ("option", "large", 3, 1), ("button", "Save", 4, -1)]


def columns(value: str = "", *, scrolled: float = 0.0) -> list[Any]:
    """The columns of a page with ROWS, 40 CSS px each."""
    tag, text, ref, parent = (list(column) for column in zip(*ROWS, strict=True))
    numbers = [number for row in zip(ref, parent, [0] * len(ROWS), strict=True) for number in row]
    boxes = [length for row in range(len(ROWS)) for length in (0.0, 40.0 * row - scrolled, 200.0, 40.0)]
    empty = [""] * len(ROWS)
    return [tag, text, [value, *empty[1:]], empty, empty, numbers, boxes, 0]


def quiet(value: str = "") -> Page:
    return decode(columns(value), SCALE).page


def message(number: int, verb: Verb, ref: int, text: str = "", *, page: list[Any] | None = None) -> str:
    """A message of site_recorder.js about a step in the middle of the first row."""
    row = [int(verb), ref, text, 100.0, 20.0, 0.0, 0.0, False]
    return json.dumps([number, row, [page, []] if page is not None else None])


def steps() -> SiteSteps:
    return SiteSteps(SCALE)


def test_a_step_that_changes_keeps_its_place_and_its_page() -> None:
    made = steps()
    made.take(DOCUMENT, message(0, Verb.TYPE, 1, "A", page=columns()))
    made.take(DOCUMENT, message(1, Verb.CLICK, 4, page=columns("Ad")))
    made.take(DOCUMENT, message(0, Verb.TYPE, 1, "Ada"))
    first, second = (one.step for one in made.recorded)
    assert (first.verb, first.text, first.page.value[0]) == (Verb.TYPE, "Ada", "")
    assert (second.verb, second.page.value[0]) == (Verb.CLICK, "Ad")
    assert first.at == (50.0, 10.0)


def test_a_step_can_become_none_and_steps_of_another_document_are_others() -> None:
    made = steps()
    made.take(DOCUMENT, message(0, Verb.TYPE, 1, "A", page=columns()))
    made.take(DOCUMENT + 1, message(0, Verb.CLICK, 4, page=columns()))
    made.take(DOCUMENT, json.dumps([0, None, None]))
    assert [one.step.verb for one in made.recorded] == [Verb.CLICK]
    made.take(DOCUMENT, message(5, Verb.CLICK, 4))  # began before the episode, its page is unknown
    assert len(made) == 1


def test_the_page_of_a_step_is_as_it_was_before_the_person_scrolled() -> None:
    made = steps()
    made.see(quiet())
    made.see(decode(columns(scrolled=90.0), SCALE).page)
    made.take(DOCUMENT, message(0, Verb.CLICK, 4, page=columns(scrolled=100.0)))
    made.take(DOCUMENT, message(1, Verb.CLICK, 4, page=columns(scrolled=100.0)))  # not seen again in between
    made.see(quiet())
    made.take(DOCUMENT, message(2, Verb.CLICK, 4, page=columns("changed", scrolled=100.0)))
    assert [float(one.step.page.box[0, 1]) for one in made.recorded] == [0.0, -50.0, -50.0]


def test_what_was_acted_on_is_marked_on_the_later_pages_of_its_document() -> None:
    made = steps()
    made.take(DOCUMENT, message(0, Verb.CLICK, 3, page=columns()))
    made.take(DOCUMENT, message(1, Verb.TYPE, 1, "Ada", page=columns()))
    made.take(DOCUMENT, message(2, Verb.CLICK, 4, page=columns("Ada")))
    made.take(DOCUMENT + 1, message(0, Verb.CLICK, 4, page=columns()))
    episode = episode_of(SPEC, GOAL, [one.step for one in made.recorded], Outcome(raw_reward=1.0, ended=True))
    assert episode is not None
    tampered = [np.flatnonzero(page.tampered).tolist() for page in episode.trajectory.pages]
    assert tampered == [[], [1, 2], [0, 1, 2], []]


@pytest.mark.parametrize(("reward", "learnable"), [(1.0, True), (-1.0, False)])
def test_a_date_that_the_page_accepted_is_the_date_of_the_instruction(reward: float, learnable: bool) -> None:
    made = steps()
    made.take(DOCUMENT, message(0, Verb.TYPE, 1, "2024-02-08", page=columns()))
    episode = episode_of(SPEC, GOAL, [one.step for one in made.recorded], Outcome(raw_reward=reward, ended=True))
    assert episode is not None
    (action,) = episode.trajectory.actions
    assert action.text(GOAL) == ("02/08/2024" if learnable else "2024-02-08")
    assert (episode.trajectory.unlearnable(BASIC) == "") is learnable


def test_typing_into_a_field_that_is_not_seen_goes_to_what_has_the_focus_and_is_not_learned() -> None:
    made = steps()
    made.take(DOCUMENT, message(0, Verb.TYPE, 4, "Ada", page=columns()))
    episode = episode_of(SPEC, GOAL, [one.step for one in made.recorded], Outcome(raw_reward=1.0, ended=True))
    assert episode is not None
    assert episode.trajectory.actions[0].element == -1
    assert episode.trajectory.unlearnable()


@pytest.mark.parametrize(
    ("dialog", "accepted", "text", "wanted"),
    [
        (Dialog("alert", "OK", ""), True, "", [("CLICK", "button", "OK")]),
        (Dialog("confirm", "Sure?", ""), False, "", [("CLICK", "button", "Cancel")]),
        (Dialog("prompt", "Name?", "Bo"), True, "Bo", [("CLICK", "button", "OK")]),
        (Dialog("prompt", "Name?", "Bo"), True, "Ada", [("TYPE", "input_text", "Ada"), ("CLICK", "button", "OK")]),
        (Dialog("prompt", "Name?", "Bo"), False, "Ada", [("CLICK", "button", "Cancel")]),
    ],
)
def test_the_answer_to_a_dialog_is_typed_and_clicked(
    dialog: Dialog, accepted: bool, text: str, wanted: list[tuple[str, str, str]]
) -> None:
    made = steps()
    made.answer(dialog, accepted=accepted, text=text)
    episode = episode_of(SPEC, GOAL, [one.step for one in made.recorded], Outcome(raw_reward=1.0, ended=True))
    assert episode is not None
    trajectory, found = episode.trajectory, []
    for page, action in zip(trajectory.pages, trajectory.actions, strict=True):
        said = action.text(GOAL) if action.verb is Verb.TYPE else page.text[action.element]
        found.append((action.verb.name, page.tag[action.element], said))
    assert found == wanted
    assert trajectory.pages[-1].value.count(text) >= (dialog.kind == "prompt" and accepted)
