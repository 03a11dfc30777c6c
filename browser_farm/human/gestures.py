"""Groups the raw DOM events of a recording into gestures: a mouse click, a mouse press or a run of keys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from browser_farm.human.recorded_pages import Node, Screen, flatten, target_of

CAPTURE_PHASE = 1  # DOM event phase; the page still is as it was before the event
# Shift, Control, Alt, CapsLock, the Meta keys, keys without a code
MODIFIER_KEYS = frozenset({16, 17, 18, 20, 91, 92, 93, 224, 255})
TAB = 9
MOUSE_EVENTS = frozenset({"mousedown", "mouseup", "click"})
REDUNDANT_EVENTS = frozenset({"keypress", "keyup", "dblclick", "scroll"})  # other events show their effect


class UnsupportedRecording(Exception):
    """The recording needs more than clicks on leaves and typing. The message is a short reason, counted by import."""


@dataclass(frozen=True, kw_only=True)
class RecordedState:
    """One entry of a recording: an event, and the page at one phase of that event."""

    body: Node
    event: str  # DOM event type, "" for the first state
    phase: int  # DOM event phase
    x: float  # px
    y: float  # px
    key_code: int  # 0 for mouse events

    @cached_property
    def screen(self) -> Screen:
        """The page as a table of rows."""
        return flatten(self.body)

    @cached_property
    def target(self) -> Node | None:
        """The event's target, None if it is not part of the page."""
        return target_of(self.body)


class GestureKind(Enum):
    """What the events of a gesture are."""

    CLICK = 1  # mousedown, mouseup, click
    PRESS = 2  # mousedown and mouseup without a click: a drag, or the page changed in between
    KEYS = 3  # consecutive keys in one element
    KEY_CLICK = 4  # a click event without a mouse: Enter or Space on a button


@dataclass(frozen=True, slots=True, kw_only=True)
class Gesture:
    """Consecutive events that belong together."""

    kind: GestureKind
    start: int  # index of its first state
    down: Node | None  # target of the first event: of mousedown, or of the keys
    target: Node | None  # target of the click event; without one, target of the last event
    label_target: Node | None  # target of the second click event, which browsers send when a label was clicked
    key_codes: frozenset[int]


def gestures_of(states: Sequence[RecordedState]) -> list[Gesture]:
    """Group the events of a recording into gestures. UnsupportedRecording for an unknown event type."""
    groups: list[list[int]] = []
    for index, state in enumerate(states):
        if not state.event or state.phase != CAPTURE_PHASE or state.event in REDUNDANT_EVENTS:
            continue
        if state.event not in MOUSE_EVENTS and state.event != "keydown":
            raise UnsupportedRecording("unsupported event")
        if state.event == "keydown" and state.key_code in MODIFIER_KEYS:
            continue
        if groups and _continues(states[groups[-1][0]], state):
            groups[-1].append(index)
        elif state.event != "mouseup":  # a mouseup that opens a group had its mousedown outside the page
            groups.append([index])
    return [_gesture(states, group) for group in groups]


def _continues(opening: RecordedState, state: RecordedState) -> bool:
    """Whether an event belongs to the gesture that began with `opening`. Each Tab key is a gesture of its own."""
    if state.event in ("mouseup", "click"):
        return opening.event == "mousedown"
    same = opening.target is not None and state.target is not None and opening.target.ref == state.target.ref
    return state.event == opening.event == "keydown" and same and TAB not in (opening.key_code, state.key_code)


def _gesture(states: Sequence[RecordedState], group: list[int]) -> Gesture:
    opening = states[group[0]]
    clicks = [states[index].target for index in group if states[index].event == "click"]
    if opening.event == "mousedown":
        kind = GestureKind.CLICK if clicks else GestureKind.PRESS
    else:
        kind = GestureKind.KEYS if opening.event == "keydown" else GestureKind.KEY_CLICK
    return Gesture(
        kind=kind,
        start=group[0],
        down=opening.target,
        target=clicks[0] if clicks else states[group[-1]].target,
        label_target=clicks[1] if len(clicks) > 1 else None,
        key_codes=frozenset(states[index].key_code for index in group),
    )
