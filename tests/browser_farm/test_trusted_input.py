"""The same actions through Chrome's own mouse and keyboard."""

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
# Chrome joins the moves between two frames, and draw-line pays by how many there were.
@pytest.mark.parametrize(("task", "moves"), [case for case in SOLVED if case[0] != "draw-line"])
def test_a_task_that_needs_more_than_clicks_is_solved_by_hand(farm: Farm, task: str, moves: tuple[Move, ...]) -> None:
    assert play(farm, farm.open(task, 3)[0], *moves) == 1.0
    assert farm.causes == []


@pytest.mark.chrome
def test_a_page_takes_the_events_for_a_persons(farm: Farm) -> None:
    script = """for (const name of ['mousedown', 'click', 'keydown', 'input']) document.addEventListener(name,
        (event) => log.push(name + event.isTrusted), true)"""
    seen = play(farm, show(farm, "<input value='ab'>", script), on(Verb.TYPE, "input_text", literal="C"), press("End"))
    assert isinstance(seen, Observation)
    assert seen.page.value[row(seen, "input_text")] == "C"
    assert set(farm.ask(0, "log.join()").split(",")) == {"mousedowntrue", "clicktrue", "keydowntrue", "inputtrue"}


@pytest.mark.chrome
def test_what_no_mouse_can_reach_is_done_by_script_all_the_same(farm: Farm) -> None:
    html = "<select><option>one</option><option>two</option></select><input type='date'>"
    seen = play(
        farm, show(farm, html), on(Verb.CLICK, "option", "two"), on(Verb.TYPE, "input_date", literal="2019-02-08")
    )
    assert isinstance(seen, Observation)
    assert seen.page.value[row(seen, "select")] == "two"
    assert seen.page.value[row(seen, "input_date")] == "2019-02-08"


def test_a_chord_holds_its_keys_down_around_the_last_one() -> None:
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
