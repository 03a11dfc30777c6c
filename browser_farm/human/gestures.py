"""Cuts the raw DOM events of a recording into gestures: a click, a press, a run of keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from browser_farm.human.recorded_pages import Node, Screen, flatten, target_of

CAPTURE = 1  # the DOM event phase in which the page is still as it was before the event
# Shift, Control, Alt, CapsLock, the Meta keys, keys without a code
SILENT_KEYS = frozenset({16, 17, 18, 20, 91, 92, 93, 224, 255})
TAB = 9
CLICKING_KINDS = frozenset({"mousedown", "mouseup", "click"})
IDLE_KINDS = frozenset({"keypress", "keyup", "dblclick", "scroll"})  # their effect is told by the others


class UnsupportedRecording(Exception):
    """This recording holds more than clicks on leaves and typing; the message is the short reason."""


@dataclass(frozen=True, kw_only=True)
class State:
    """One moment of a recording: the page, and the event that was about to reach it or just had."""

    body: Node
    kind: str  # DOM event type, "" for the opening state
    timing: int  # DOM event phase
    x: float  # px
    y: float  # px
    code: int  # key code, 0 for mouse events

    @cached_property
    def screen(self) -> Screen:
        return flatten(self.body)

    @cached_property
    def target(self) -> Node | None:
        return target_of(self.body)


class Kind(Enum):
    CLICK = 1  # mouse button down, up, click
    PRESS = 2  # mouse button down and up with no click: a drag, or the page changed in between
    KEYS = 3  # a run of keys in one element
    KEY_CLICK = 4  # a click that came without a mouse: Enter or Space on a button


@dataclass(frozen=True, slots=True, kw_only=True)
class Gesture:
    """Events that belong together."""

    kind: Kind
    first: int  # state in which it begins
    down: Node | None  # where the mouse button went down, or what had the keys
    target: Node | None  # what was clicked; where the button came up when nothing was
    relayed: Node | None  # what a label passed its click on to
    codes: frozenset[int]


def gestures_of(states: Sequence[State]) -> list[Gesture]:
    """Cut the events of a recording into gestures."""
    groups: list[list[int]] = []
    for index, state in enumerate(states):
        if not state.kind or state.timing != CAPTURE or state.kind in IDLE_KINDS:
            continue
        if state.kind not in CLICKING_KINDS and state.kind != "keydown":
            raise UnsupportedRecording("unsupported action")
        if state.kind == "keydown" and state.code in SILENT_KEYS:
            continue
        if groups and _continues(states, groups[-1], state):
            groups[-1].append(index)
        elif state.kind != "mouseup":  # its mousedown fell outside the page
            groups.append([index])
    return [_gesture(states, group) for group in groups]


def _continues(states: Sequence[State], group: list[int], state: State) -> bool:
    opening = states[group[0]]
    if state.kind in ("mouseup", "click"):
        return opening.kind == "mousedown"
    same = opening.target is not None and state.target is not None and opening.target.ref == state.target.ref
    return state.kind == opening.kind == "keydown" and same and TAB not in (opening.code, state.code)


def _gesture(states: Sequence[State], group: list[int]) -> Gesture:
    opening = states[group[0]]
    clicks = [states[index].target for index in group if states[index].kind == "click"]
    if opening.kind == "mousedown":
        kind = Kind.CLICK if clicks else Kind.PRESS
    else:
        kind = Kind.KEYS if opening.kind == "keydown" else Kind.KEY_CLICK
    return Gesture(
        kind=kind,
        first=group[0],
        down=opening.target,
        target=clicks[0] if clicks else states[group[-1]].target,
        relayed=clicks[1] if len(clicks) > 1 else None,
        codes=frozenset(states[index].code for index in group),
    )
