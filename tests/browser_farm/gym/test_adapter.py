"""The translation of the miniwob package's actions to commands, and of pages to its observations."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from miniwob.action import ActionSpaceConfig, ActionTypes
from miniwob.constants import ALL_POSSIBLE_KEYS, WEBDRIVER_SPECIAL_KEYS
from miniwob.observation import create_observation

from benchmarks.gym_equality import differences
from browser_farm.gym.adapter import MiniWoBAdapter, chord_of, root_dom
from browser_farm.gym.elements import Elements, decode_elements, rgba
from browser_farm.gym.slot import ResetOptions
from giirl_core.keys import TYPED_KEYS
from giirl_core.types import Command, Verb

FIELDS = [("target", "Ada"), ("place", "top")]


# ref, parent row, flags, background and foreground of each element
NUMBERS = [1, -1, 1, 0, 1, 2, 0, 2, 2, 3, 3, 1, 8, 1, 2, 4, 0, 8, 1, 2, 5, 0, 0, 1, 2, -1, 4, 8, 0, 0]
NUMBERS += [6, 4, 8, 1, 2, -2, 4, 8, 0, 0]


def page() -> Elements:
    """A button with an SVG in it, a checkbox, two lines of text."""
    return decode_elements(
        [
            ["Press it.", None],
            ["body", "button", "svg", "input_checkbox", "p", "t", "br", "t"],
            ["", "", "", "", "", "one", "", "two" * 100],
            [None, None, None, True, None, None, None, None],
            ["", "go", "", "", "", "", "", ""],
            ["", "big red", "SVG_CLASS", "", "", "", "", ""],
            NUMBERS,
            [float(number) / 3 for number in range(32)],
            ["", "rgba(255, 0, 128, 0.5)", "rgb(1, 2, 3)", "color(srgb 1 0 0)"],
        ]
    )


def command(
    kind: str, fields: list[tuple[str, str]] | None = None, preset: str = "all_supported", **values: Any
) -> Command:
    adapter = MiniWoBAdapter.of("enter-text", preset)
    action = adapter.create_action(adapter.action_space, kind, values)
    return adapter.command(action, page(), FIELDS if fields is None else fields)


CASES: list[tuple[str, dict[str, Any], Command]] = [
    ("NONE", {}, Command(verb=Verb.WAIT)),
    ("MOVE_COORDS", {"coords": np.array([3, 4])}, Command(verb=Verb.HOVER, at=(3.0, 4.0))),
    ("CLICK_COORDS", {"coords": np.array([3, 4])}, Command(verb=Verb.CLICK, at=(3.0, 4.0))),
    ("DBLCLICK_COORDS", {"coords": np.array([3, 4])}, Command(verb=Verb.DOUBLE_CLICK, at=(3.0, 4.0))),
    ("MOUSEDOWN_COORDS", {"coords": np.array([3, 4])}, Command(verb=Verb.MOUSE_DOWN, at=(3.0, 4.0))),
    ("MOUSEUP_COORDS", {"coords": np.array([3, 4])}, Command(verb=Verb.MOUSE_UP, at=(3.0, 4.0))),
    ("SCROLL_UP_COORDS", {"coords": np.array([3, 4])}, Command(verb=Verb.SCROLL, at=(3.0, 4.0), by=(0.0, -50.0))),
    ("SCROLL_DOWN_COORDS", {"coords": np.array([3, 4])}, Command(verb=Verb.SCROLL, at=(3.0, 4.0), by=(0.0, 50.0))),
    ("CLICK_ELEMENT", {"ref": 2}, Command(verb=Verb.ACTIVATE, ref=2)),
    ("PRESS_KEY", {"key": 0}, Command(verb=Verb.PRESS, text="Enter")),
    ("TYPE_TEXT", {"text": "Eve"}, Command(verb=Verb.APPEND, text="Eve")),
    ("TYPE_FIELD", {"field": 1}, Command(verb=Verb.APPEND, text="top")),
    ("TYPE_FIELD", {"field": 2}, Command(verb=Verb.APPEND)),
    ("FOCUS_ELEMENT_AND_TYPE_TEXT", {"ref": 4, "text": "Eve"}, Command(verb=Verb.ACTIVATE, ref=4, text="Eve")),
    ("FOCUS_ELEMENT_AND_TYPE_FIELD", {"ref": 4, "field": 0}, Command(verb=Verb.ACTIVATE, ref=4, text="Ada")),
    # An unknown ref gets no click, but the text is typed.
    ("CLICK_ELEMENT", {"ref": 77}, Command(verb=Verb.APPEND)),
    ("FOCUS_ELEMENT_AND_TYPE_TEXT", {"ref": 77, "text": "Eve"}, Command(verb=Verb.APPEND, text="Eve")),
]


@pytest.mark.parametrize(("kind", "values", "wanted"), CASES)
def test_every_action_of_the_package_becomes_one_command(kind: str, values: dict[str, Any], wanted: Command) -> None:
    assert command(kind, **values) == wanted


def test_the_cases_cover_every_action_type() -> None:
    assert {kind for kind, _, _ in CASES} >= {kind.value for kind in ActionTypes}


def test_binned_coordinates_point_at_the_middle_of_their_bin() -> None:
    click = command("CLICK_COORDS", preset="humphreys22", coords=np.array([0, 50]))
    assert click.at == pytest.approx((160 / 51 / 2, 210 - 210 / 51 / 2))


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("<Enter>", "Enter"),
        ("<NumpadEnter>", "Enter"),
        ("<Space>", " "),
        ("<NumpadAdd>", "+"),
        ("<Numpad7>", "7"),
        ("<ArrowLeft>", "ArrowLeft"),
        ("A", "A"),
        ("-", "-"),
        ("C-a", "Control+a"),
        ("C-S-<Tab>", "Control+Shift+Tab"),
        ("M--", "Meta+-"),
    ],
)
def test_keys_of_the_package_become_chords(name: str, wanted: str) -> None:
    assert chord_of(name) == wanted


def test_every_key_of_the_package_is_supported_and_typed_as_in_webdriver() -> None:
    for name in ALL_POSSIBLE_KEYS:
        chord_of(name)
    assert {TYPED_KEYS[character]: chord_of(name) for name, character in WEBDRIVER_SPECIAL_KEYS.items()} == {
        key: key for character, key in TYPED_KEYS.items() if character != "\n"
    }


def test_every_key_of_the_presets_is_supported() -> None:
    for preset in ("all_supported", "shi17", "liu18", "humphreys22", "all_supported_mac_os"):
        MiniWoBAdapter.of("click-test", preset)


@pytest.mark.parametrize(
    ("message", "call"),
    [
        ("there is no MiniWoB task 'clik-test'", lambda: MiniWoBAdapter.of("clik-test")),
        ("Unknown preset", lambda: MiniWoBAdapter.of("click-test", "all")),
        (
            "the key '<Hlp>' is not supported",
            lambda: MiniWoBAdapter.of("click-test", ActionSpaceConfig([ActionTypes.PRESS_KEY], allowed_keys=["<Hlp>"])),
        ),
        (
            "is not an action of enter-text",
            lambda: MiniWoBAdapter.of("enter-text").command({"action_type": 99}, page(), []),
        ),
        (
            "is not an action of enter-text",
            lambda: MiniWoBAdapter.of("enter-text").command({"action_type": 8}, page(), []),
        ),
        ("is not an action of enter-text", lambda: MiniWoBAdapter.of("enter-text").command(7, page(), [])),  # type: ignore[arg-type]
        ("data_mode is 'exam'", lambda: ResetOptions(data_mode="exam")),
        ("reset got option 'speed'", lambda: ResetOptions().updated({"speed": 1})),
    ],
)
def test_invalid_arguments_raise_a_one_line_error(message: str, call: Any) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_our_observation_equals_the_packages_observation_of_the_dom_tree() -> None:
    adapter = MiniWoBAdapter.of("enter-text")
    observation = adapter.observe(page(), FIELDS, None)
    wanted = create_observation("Press it.", root_dom(page()), observation["screenshot"], FIELDS)
    assert list(differences(observation, wanted)) == []
    assert observation in adapter.observation_space


def test_two_observations_share_no_arrays() -> None:
    shared = page()
    first, second = (MiniWoBAdapter.of("enter-text").observe(shared, FIELDS, None) for _ in range(2))
    first["dom_elements"][1]["left"][0] = first["dom_elements"][1]["flags"][0] = 9
    assert second["dom_elements"][1]["left"][0] != 9
    assert second["dom_elements"][1]["flags"][0] != 9


@pytest.mark.parametrize(
    ("colour", "wanted"),
    [
        ("", (1, 1, 1, 1)),
        ("rgb(255, 0, 51)", (1, 0, 0.2, 1)),
        ("rgba(0, 51, 0, 0.25)", (0, 0.2, 0, 0.25)),
        ("color(srgb 1 0 0)", (1, 1, 1, 1)),
    ],
)
def test_colours_become_rgba_and_unknown_notations_become_white(colour: str, wanted: tuple[float, ...]) -> None:
    assert rgba(colour) == pytest.approx(wanted)


def test_importing_browser_farm_registers_the_environment_and_loads_no_browser_library() -> None:
    script = (
        "import sys, browser_farm, gymnasium\n"
        "assert 'giirl/MiniWoB-v0' in gymnasium.registry\n"
        "print(*{'selenium', 'websocket', 'torch', 'ray', 'miniwob', 'PIL'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == ""
