"""Actions as native mouse and keyboard input of Chrome."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from browser_farm.chrome.trusted_input import events
from giirl_core.types import Command, Observation, Verb
from tests.browser_farm.real_farm import Farm
from tests.browser_farm.test_actions import SOLVED, Move, on, play, press, row, show


@pytest.fixture(scope="module")
def farm() -> Iterator[Farm]:
    trusted = Farm(trusted=True)
    yield trusted
    trusted.chrome.close()


@pytest.mark.chrome
# Chrome merges the mouse moves between two frames, and the reward of draw-line depends on their number.
@pytest.mark.parametrize(("task", "moves"), [case for case in SOLVED if case[0] != "draw-line"])
def test_a_task_that_needs_more_than_clicks_is_solved_with_trusted_input(
    farm: Farm, task: str, moves: tuple[Move, ...]
) -> None:
    assert play(farm, farm.open(task, 3)[0], *moves) == 1.0
    assert farm.causes == []


@pytest.mark.chrome
def test_the_events_are_trusted(farm: Farm) -> None:
    script = """for (const name of ['mousedown', 'click', 'keydown', 'input']) document.addEventListener(name,
        (event) => log.push(name + event.isTrusted), true)"""
    seen = play(farm, show(farm, "<input value='ab'>", script), on(Verb.TYPE, "input_text", literal="C"), press("End"))
    assert isinstance(seen, Observation)
    assert seen.page.value[row(seen, "input_text")] == "C"
    assert set(farm.ask(0, "log.join()").split(",")) == {"mousedowntrue", "clicktrue", "keydowntrue", "inputtrue"}


@pytest.mark.chrome
def test_actions_that_native_input_cannot_perform_are_done_by_script(farm: Farm) -> None:
    html = "<select><option>one</option><option>two</option></select><input type='date'>"
    seen = play(
        farm, show(farm, html), on(Verb.CLICK, "option", "two"), on(Verb.TYPE, "input_date", literal="2019-02-08")
    )
    assert isinstance(seen, Observation)
    assert seen.page.value[row(seen, "select")] == "two"
    assert seen.page.value[row(seen, "input_date")] == "2019-02-08"


def test_a_chord_holds_its_modifiers_down_around_its_key() -> None:
    aim = [1.0, 2.0, 3.0, 4.0]
    pressed = events(Command(verb=Verb.PRESS, text="Control+c"), aim)
    assert [(params["type"], params["key"]) for _, params in pressed] == [
        ("rawKeyDown", "Control"),
        ("rawKeyDown", "c"),
        ("keyUp", "c"),
        ("keyUp", "Control"),
    ]
    assert pressed[1][1]["commands"] == ["copy"]
    assert events(Command(verb=Verb.WAIT), aim) == []


def test_typed_characters_of_webdriver_press_their_keys() -> None:
    typed = events(Command(verb=Verb.APPEND, text="a\ue012\ue008\ue01f\n"), [0.0, 0.0, 0.0, 0.0])
    assert [params["key"] for _, params in typed if params["type"] != "keyUp"] == [
        "a",
        "ArrowLeft",
        "Shift",
        "5",
        "Enter",
    ]
