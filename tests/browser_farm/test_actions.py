"""Every verb in real Chrome: tasks that need it, and test pages that log the events that reach them."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from giirl_core.types import Action, Command, Observation, Verb
from tests.browser_farm.real_farm import Farm

pytestmark = pytest.mark.chrome

Move = Callable[[Observation], Action]  # chooses an action on a page


def row(observation: Observation, tag: str, text: str = "", number: int = 0) -> int:
    """The row of the number-th element with this tag whose text begins with `text`."""
    page = observation.page
    return [i for i in range(len(page)) if page.tag[i] == tag and page.text[i].startswith(text)][number]


def on(verb: Verb, tag: str, text: str = "", number: int = 0, **rest: object) -> Move:
    return lambda observation: Action(verb=verb, element=row(observation, tag, text, number), **rest)  # type: ignore[arg-type]


def press(keys: str) -> Move:
    return lambda observation: Action(verb=Verb.PRESS, literal=keys)


SUBMIT = on(Verb.CLICK, "button", "Submit")


def play(farm: Farm, observation: Observation, *moves: Move) -> Observation | float:
    """Play some moves. Returns the last observation, or the reward if the episode ended with the last move."""
    for move in moves:
        result = farm.chrome.step({0: Command.of(move(observation), observation)})[0]
        assert result.lost == ""
        if result.done:
            assert move is moves[-1]
            return result.raw_reward
        assert result.observation is not None
        observation = result.observation
    return observation


def show(farm: Farm, html: str, script: str = "") -> Observation:
    """Replace the page by `html` and run `script`, which logs events to the global list `log`."""
    farm.open("click-test-2", 1)  # so that the next task loads a new document
    observation = farm.open("click-test", 1)[0]
    farm.run(0, f"document.getElementById('area').innerHTML = {html!r}; window.log = []; {script}")
    shown = play(farm, observation, lambda observation: Action(verb=Verb.WAIT))
    assert isinstance(shown, Observation)
    return shown


def _drag_the_small_box_into_the_large_one(observation: Observation) -> Action:
    small, large = row(observation, "div", "s"), row(observation, "div", "L")
    return Action(verb=Verb.DRAG, element=small, to=large)


def _select_the_whole_text(observation: Observation) -> Action:
    text = max(range(len(observation.page)), key=lambda i: len(observation.page.text[i]))
    _, _, width, height = map(float, observation.page.box[text])
    corner = (1 - width / 2, 2 - height / 2)
    return Action(verb=Verb.DRAG, element=text, at=corner, by=(width + 8, height - 4))


def _draw_a_line_through_the_dot(observation: Observation) -> Action:
    dot = row(observation, "circle")
    away = (0.0, 30.0) if "vertical" in observation.goal.utterance else (30.0, 0.0)
    return Action(verb=Verb.DRAG, element=dot, at=(-away[0], -away[1]), by=(2 * away[0], 2 * away[1]))


def _click_the_named_colour(observation: Observation) -> Action:
    colour = observation.goal.utterance.split()[3]
    left, top, width, height = map(float, observation.page.box[observation.page.colour.index(colour)])
    return Action(verb=Verb.CLICK, at=(left + width / 3, top + height / 3))


def _drag_the_corner(observation: Observation) -> Action:
    by = 20.0 if "larger" in observation.goal.utterance else -20.0
    corner = next(i for i, names in enumerate(observation.page.classes) if "ui-resizable-se" in names)
    return Action(verb=Verb.DRAG, element=corner, by=(by, by))


def _scroll_to_the_end(observation: Observation) -> Action:
    by = (0.0, 5000.0 if "bottom" in observation.goal.utterance else -5000.0)
    return Action(verb=Verb.SCROLL, element=row(observation, "textarea"), by=by)


SOLVED: list[tuple[str, tuple[Move, ...]]] = [
    ("drag-box", (_drag_the_small_box_into_the_large_one, SUBMIT)),
    ("highlight-text", (_select_the_whole_text, SUBMIT)),
    ("draw-line", (_draw_a_line_through_the_dot, SUBMIT)),
    ("click-color", (_click_the_named_colour,)),
    ("resize-textarea", (_drag_the_corner, SUBMIT)),
    ("scroll-text-2", (_scroll_to_the_end, SUBMIT)),
    (
        "copy-paste",
        (
            on(Verb.CLICK, "textarea"),
            press("Control+a"),
            press("Control+c"),
            on(Verb.CLICK, "input_text"),
            press("Control+v"),
            SUBMIT,
        ),
    ),
]


@pytest.mark.parametrize("seed", [3, 8])
@pytest.mark.parametrize(("task", "moves"), SOLVED)
def test_a_task_that_needs_more_than_clicks_is_solved(
    farm: Farm, task: str, moves: tuple[Move, ...], seed: int
) -> None:
    assert play(farm, farm.open(task, seed)[0], *moves) == 1.0


@pytest.mark.parametrize(
    ("moves", "value"),
    [
        ((on(Verb.APPEND, "input_text", literal="cd"),), "abcd"),
        ((on(Verb.TYPE, "input_text", literal="cd"),), "cd"),
        ((on(Verb.CLICK, "input_text"), press("Home"), press("x"), press("Shift+X"), press("Delete")), "xXb"),
        ((on(Verb.CLICK, "input_text"), press("End"), press("Backspace")), "a"),
        ((on(Verb.CLICK, "input_text"), press("Control+a"), press("Control+x"), *(press("Control+v"),) * 2), "abab"),
        ((on(Verb.CLICK, "input_text"), press("End"), lambda _: Action(verb=Verb.APPEND, literal="!")), "ab!"),
        ((on(Verb.PRESS, "input_text", literal="End"), press("ArrowLeft"), press("-")), "a-b"),
    ],
)
def test_typing_and_keys_edit_a_field(farm: Farm, moves: tuple[Move, ...], value: str) -> None:
    observation = play(farm, show(farm, '<input value="ab">'), *moves)
    assert isinstance(observation, Observation)
    assert observation.page.value[row(observation, "input_text")] == value


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("number", "-5.5", "-5.5"),
        ("email", "a@b.c", "a@b.c"),
        ("date", "2019-02-08", "2019-02-08"),
        ("date", "02/08/2019", "2019-02-08"),
        ("time", "19:16", "19:16"),
        ("time", "7:16 PM", "19:16"),
        ("time", "12:05 AM", "00:05"),
        ("range", "30", "30"),
    ],
)
def test_typed_text_is_converted_to_the_format_of_the_field(farm: Farm, kind: str, text: str, value: str) -> None:
    observation = show(farm, f'<input type="{kind}">')
    observation = play(farm, observation, on(Verb.TYPE, f"input_{kind}", literal=text))  # type: ignore[assignment]
    assert observation.page.value[row(observation, f"input_{kind}")] == value


def test_enter_submits_a_form_tab_moves_the_focus_and_space_presses(farm: Farm) -> None:
    html = '<form id="f"><input id="a"><input type="checkbox" id="b"><button>Go</button></form>'
    script = "document.getElementById('f').addEventListener('submit', (event) => log.push('sent'));"
    observation = show(farm, html, script)
    play(farm, observation, on(Verb.CLICK, "input_text"), press("Tab"), press(" "), press("Shift+Tab"), press("Enter"))
    assert farm.ask(0, "log + ',' + document.getElementById('b').checked") == "sent,true"
    assert farm.ask(0, "document.activeElement.textContent || document.activeElement.id") == "Go"


def test_a_double_click_sends_two_clicks_and_a_dblclick_event(farm: Farm) -> None:
    script = """for (const name of ['mousedown', 'mouseup', 'click', 'dblclick'])
        document.getElementById('d').addEventListener(name, (event) => log.push(name + event.detail))"""
    play(farm, show(farm, '<div id="d">here</div>', script), on(Verb.DOUBLE_CLICK, "div", "here"))
    assert farm.ask(0, "log.join()") == ("mousedown1,mouseup1,click1,mousedown2,mouseup2,click2,dblclick2")


def test_hovering_enters_one_element_and_leaves_the_other(farm: Farm) -> None:
    script = """for (const name of ['mouseenter', 'mouseleave']) for (const id of ['d', 'e'])
        document.getElementById(id).addEventListener(name, () => log.push(name.slice(5) + ' ' + id))"""
    observation = show(farm, '<div id="d">one</div><div id="e">two</div>', script)
    play(farm, observation, on(Verb.HOVER, "div", "one"), on(Verb.HOVER, "div", "one"), on(Verb.HOVER, "div", "two"))
    assert farm.ask(0, "log.join()") == "enter d,leave d,enter e"


def test_mouse_down_move_and_up_happen_at_the_given_positions(farm: Farm) -> None:
    script = """for (const name of ['mousedown', 'mousemove', 'mouseup', 'click']) document.addEventListener(name,
        (event) => log.push(name + Math.round(event.clientX) + ':' + event.buttons))"""
    down, up = Action(verb=Verb.MOUSE_DOWN, at=(20.0, 90.0)), Action(verb=Verb.MOUSE_UP, at=(40.0, 90.0))
    move = Action(verb=Verb.HOVER, at=(30.0, 90.0))
    play(farm, show(farm, "", script), lambda _: down, lambda _: move, lambda _: up)
    assert farm.ask(0, "log.join()") == (
        "mousemove20:0,mousedown20:1,mousemove30:1,mousemove40:1,mouseup40:0,click40:0"
    )


def test_a_click_with_an_offset_reaches_the_element_at_that_position(farm: Farm) -> None:
    observation = show(farm, '<div id="o" style="width:60px;height:20px">a<button id="i">b</button></div>')
    farm.run(0, "document.addEventListener('click', (event) => log.push(event.target.id), true)")
    inner = observation.page.box[row(observation, "button")]
    outer = observation.page.box[observation.page.parent[row(observation, "button")]]
    offset = tuple(float(v) for v in inner[:2] + inner[2:] / 2 - outer[:2] - outer[2:] / 2)
    area = int(observation.page.parent[row(observation, "button")])
    play(farm, observation, lambda _: Action(verb=Verb.CLICK, element=area, at=offset))  # type: ignore[arg-type]
    assert farm.ask(0, "log.join()") == "i"


def test_activate_clicks_and_focuses_without_mouse_events(farm: Farm) -> None:
    script = """for (const name of ['mousemove', 'mousedown', 'click']) document.addEventListener(name,
        (event) => log.push(name), true)"""
    play(farm, show(farm, "<input>", script), on(Verb.ACTIVATE, "input_text"))
    assert farm.ask(0, "log + ' ' + document.activeElement.tagName") == "click INPUT"


def test_the_page_has_colours_and_corners_of_drawings(farm: Farm) -> None:
    html = """<svg width="90" height="90"><g transform="translate(10,0)"><polygon points="0,20 10,0 20,20" fill="red"/>
        <line x1="0" y1="30" x2="20" y2="40" style="stroke: blue"/></g><circle cx="50" cy="50" r="5" fill="#00f"/>
        <rect width="9" height="9" style="fill: lime"/></svg><p style="background-color: yellow">word</p>"""
    observation = show(farm, html.replace("\n", ""))
    page = observation.page
    left, top = (float(v) for v in page.box[row(observation, "svg")][:2])

    def looks(tag: str) -> tuple[str, str]:
        return page.colour[row(observation, tag)], page.shape[row(observation, tag)]

    def corners(*points: tuple[float, float]) -> str:
        return " ".join(f"{left + x:g},{top + y:g}" for x, y in points)

    assert looks("polygon") == ("red", "triangle " + corners((10, 20), (20, 0), (30, 20)))
    assert looks("line") == ("", "line " + corners((10, 30), (30, 40)))
    assert (looks("circle"), looks("rect")) == (("#00f", "circle"), ("lime", "rectangle"))
    assert looks("p") == ("yellow", "")


def test_the_page_has_the_attributes_that_describe_elements(farm: Farm) -> None:
    html = """<input id="name" placeholder="Your  name"><button aria-label="Close it" title="x">X</button>
        <p>word</p><a alt="up" data-x="1">Y</a>"""
    observation = show(farm, html.replace("\n", ""))
    found = {tag: observation.page.attributes[row(observation, tag)] for tag in ("input_text", "button", "p", "a")}
    assert found == {"input_text": "name Your name", "button": "Close it", "p": "", "a": "up"}


def test_text_for_screen_readers_only_is_not_on_the_page(farm: Farm) -> None:
    hidden = "position: absolute; width: 1px; height: 1px; overflow: hidden; clip: rect(0 0 0 0)"
    observation = show(farm, f'<a>Paris</a><div style="{hidden}"><b>1 result</b></div>')
    assert "Paris" in observation.page.text
    assert "1 result" not in observation.page.text


@pytest.mark.parametrize("seed", range(4))
def test_the_page_has_the_shape_that_a_canvas_shows(farm: Farm, seed: int) -> None:
    observation = farm.open("count-sides", seed)[0]
    sides = len(observation.page.shape[row(observation, "canvas")].split()) - 1
    assert play(farm, observation, on(Verb.CLICK, "button", str(sides))) == 1.0
