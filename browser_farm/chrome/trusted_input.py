"""Actions as native mouse and keyboard events of Chrome's Input domain (`isTrusted` is true): exact, but slower."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from giirl_core.keys import MODIFIERS, NAMED_KEYS, TYPED_KEYS, key_code, parse_chord
from giirl_core.types import Command, Verb

# Chrome dispatches input at once to a page that counts as focused; to a hidden page it may wait for a frame.
EMULATION = (("Emulation.setFocusEmulationEnabled", {"enabled": True}),)
MOUSE, KEY = "Input.dispatchMouseEvent", "Input.dispatchKeyEvent"
DRAG_MOVES = 6
EDITING = {"a": "selectAll", "c": "copy", "x": "cut", "v": "paste", "z": "undo"}
WORDS = {"Enter": "\r", "Tab": "\t"}  # text of the keys that are not named by their character

Event = tuple[str, dict[str, Any]]  # DevTools method, parameters


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """Start and end point of an action on the page, CSS px."""

    x: float
    y: float
    end_x: float
    end_y: float


def events(command: Command, aim: list[Any]) -> list[Event]:
    """The input events of an action. `aim` is page.js's answer to `pages.aim_call`: x, y, end x, end y in CSS px."""
    x, y, end_x, end_y = map(float, aim)
    return list(_events(command, Aim(x=x, y=y, end_x=end_x, end_y=end_y)))


def _events(command: Command, aim: Aim) -> Iterator[Event]:
    verb, has_element = command.verb, bool(command.ref)
    if verb in (Verb.CLICK, Verb.DOUBLE_CLICK):
        yield from _click(aim, 1)
        if verb is Verb.DOUBLE_CLICK:
            yield from _click(aim, 2)
    elif verb is Verb.HOVER:
        yield _mouse("mouseMoved", aim.x, aim.y)
    elif verb is Verb.MOUSE_DOWN:
        yield _mouse("mouseMoved", aim.x, aim.y)
        yield _mouse("mousePressed", aim.x, aim.y, clickCount=1)
    elif verb is Verb.MOUSE_UP:
        yield _mouse("mouseMoved", aim.x, aim.y, buttons=1)
        yield _mouse("mouseReleased", aim.x, aim.y, clickCount=1)
    elif verb is Verb.DRAG:
        yield from _drag(aim)
    elif verb is Verb.SCROLL:
        yield _mouse("mouseWheel", aim.x, aim.y, deltaX=command.by[0], deltaY=command.by[1])
    elif verb is Verb.PRESS:
        yield from _press(command.text)
    elif verb in (Verb.TYPE, Verb.APPEND):
        if has_element:
            yield from _click(aim, 1)
        if verb is Verb.TYPE:
            yield from _press("Control+a")
            yield from _press("Backspace")
        elif has_element:
            yield from _press("End")
        for character in command.text:
            yield from _press(TYPED_KEYS.get(character, character))


def _mouse(kind: str, x: float, y: float, **params: Any) -> Event:
    button = "left" if kind in ("mousePressed", "mouseReleased") or params.get("buttons") else "none"
    return MOUSE, {"type": kind, "x": x, "y": y, "button": button, **params}


def _click(aim: Aim, count: int) -> Iterator[Event]:
    yield _mouse("mouseMoved", aim.x, aim.y)
    yield _mouse("mousePressed", aim.x, aim.y, clickCount=count)
    yield _mouse("mouseReleased", aim.x, aim.y, clickCount=count)


def _drag(aim: Aim) -> Iterator[Event]:
    yield _mouse("mouseMoved", aim.x, aim.y)
    yield _mouse("mousePressed", aim.x, aim.y, clickCount=1)
    for step in range(1, DRAG_MOVES + 1):
        fraction = step / DRAG_MOVES
        x, y = aim.x + fraction * (aim.end_x - aim.x), aim.y + fraction * (aim.end_y - aim.y)
        yield _mouse("mouseMoved", x, y, buttons=1)
    yield _mouse("mouseReleased", aim.end_x, aim.end_y, clickCount=1)


def _press(keys: str) -> Iterator[Event]:
    held, key = parse_chord(keys)
    if key.isupper():
        held |= MODIFIERS["Shift"]
    command = held & (MODIFIERS["Control"] | MODIFIERS["Alt"] | MODIFIERS["Meta"])
    params: dict[str, Any] = {"key": key, "windowsVirtualKeyCode": key_code(key), "modifiers": held}
    for name, bit in MODIFIERS.items():
        if command & bit:
            yield KEY, {"type": "rawKeyDown", "key": name, "windowsVirtualKeyCode": NAMED_KEYS[name], "modifiers": held}
    text = "" if command else key if len(key) == 1 else WORDS.get(key, "")
    commands = [EDITING[key.lower()]] if command == MODIFIERS["Control"] and key.lower() in EDITING else []
    yield KEY, {"type": "keyDown" if text else "rawKeyDown", "text": text, "commands": commands, **params}
    yield KEY, {"type": "keyUp", **params}
    for name, bit in MODIFIERS.items():
        if command & bit:
            yield KEY, {"type": "keyUp", "key": name, "windowsVirtualKeyCode": NAMED_KEYS[name]}
