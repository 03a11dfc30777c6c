"""One gesture of a recording with the pages around it: the input of the rules that infer actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from browser_farm.human.gestures import (
    CAPTURE_PHASE,
    MOUSE_EVENTS,
    Gesture,
    GestureKind,
    RecordedState,
    UnsupportedRecording,
)
from browser_farm.human.recorded_pages import Node, Screen
from giirl_core.types import TYPABLE_TAGS, Verb

TOGGLE_TAGS = frozenset({"input_checkbox", "input_radio"})
NO_ROW = -1


@dataclass(frozen=True, slots=True, kw_only=True)
class InferredAction:
    """One action of the person, and the state on whose page it was decided."""

    state: int
    verb: Verb
    row: int  # in the screen of that state
    ref: int
    text: str = ""  # for TYPE: the complete value of the field afterwards


@dataclass(frozen=True, slots=True, kw_only=True)
class GestureContext:
    """A gesture, and what the pages before and after it show."""

    states: Sequence[RecordedState]
    gesture: Gesture
    following: Gesture | None
    before: int  # index of the state whose page the person saw when deciding
    strict: bool  # a demonstration to imitate, not a failure

    @property
    def is_last(self) -> bool:
        """Whether the gesture ends the recording."""
        return self.following is None

    @property
    def after(self) -> int:
        """Index of the state in which the next gesture begins, or of the last state."""
        return len(self.states) - 1 if self.following is None else self.following.start

    @property
    def screen(self) -> Screen:
        """The page on which the action was decided."""
        return self.states[self.before].screen

    @property
    def later_screen(self) -> Screen:
        """The page when the next gesture begins."""
        return self.states[self.after].screen

    @property
    def clicked(self) -> Node | None:
        """The node at which a mouse gesture was aimed, None if it is not part of the page."""
        gesture = self.gesture
        checkbox = checkbox_of_label(gesture)
        if checkbox is not None:
            return checkbox
        if gesture.target is None or (gesture.kind is GestureKind.PRESS and self.is_last):
            return gesture.down  # the page ended the episode before the click event
        known = gesture.target.ref in self.screen.row_of
        return gesture.target if known or gesture.down is None else gesture.down

    @property
    def clicked_row(self) -> int:
        """The row of `clicked`, NO_ROW if it has none."""
        return self.row_of(self.clicked)

    @property
    def clicks_leaf(self) -> bool:
        """Whether the mouse gesture was aimed at an element without visible children."""
        row = self.clicked_row
        return row != NO_ROW and self.screen.is_leaf(row)

    def row_of(self, node: Node | None) -> int:
        """The row of a node on the page before the gesture, NO_ROW if it has none."""
        return NO_ROW if node is None else self.screen.row_of.get(node.ref, NO_ROW)

    def page_unchanged(self, *, compare_boxes: bool = True) -> bool:
        """Whether the page is the same when the next gesture begins, except for the focus."""
        return self.screen.same_except_focus(self.later_screen, compare_boxes=compare_boxes)

    def page_reacted(self) -> bool:
        """Whether the page handled an event of this gesture. Scroll bars and running animations do not count.

        Compares the page of an event's capture phase with the page of its bubble phase. A missing bubble phase means
        that a handler stopped the event, so the page reacted.
        """
        for index in range(self.gesture.start, self.after):
            state, next_state = self.states[index], self.states[index + 1]
            if state.event not in MOUSE_EVENTS or state.phase != CAPTURE_PHASE:
                continue
            if next_state.event != state.event or next_state.phase == CAPTURE_PHASE:
                return True
            if not state.screen.same_except_focus(next_state.screen):
                return True
        # Browsers change the checkbox of a clicked label only after the event.
        return any(node.tag in TOGGLE_TAGS and self.flipped(node) for node in self.screen.nodes)

    def flipped(self, node: Node) -> bool:
        """Whether a checkbox changed, or a radio button was switched on (switching on one switches another off)."""
        row = self.later_screen.row_of.get(node.ref)
        value = node.value if row is None else self.later_screen.nodes[row].value
        return value != node.value and (node.tag == "input_checkbox" or value == "checked")

    def click(self, row: int) -> InferredAction:
        """A click on a row of the page before the gesture."""
        return InferredAction(state=self.before, verb=Verb.CLICK, row=row, ref=self.screen.nodes[row].ref)

    def typed_into(self, field: Node | None) -> InferredAction | None:
        """Typing, recognised by its effect: the field has another value when the next gesture begins.

        None if the value is the same or `field` is no field. UnsupportedRecording for fields that a policy cannot type
        into, for example sliders.
        """
        row = self.row_of(field)
        if (
            field is None
            or row == NO_ROW
            or field.tag in TOGGLE_TAGS
            or not field.tag.startswith(("input_", "textarea"))
        ):
            return None
        for index in range(self.after, self.gesture.start, -1):  # the field may have been removed at the end
            screen = self.states[index].screen
            if field.ref not in screen.row_of:
                continue
            text = screen.nodes[screen.row_of[field.ref]].value
            if text == self.screen.nodes[row].value:
                return None
            if field.tag not in TYPABLE_TAGS:
                raise UnsupportedRecording("field takes no text")
            return InferredAction(state=self.before, verb=Verb.TYPE, row=row, ref=field.ref, text=text)
        return None


def checkbox_of_label(gesture: Gesture) -> Node | None:
    """A click on a label is a click on its checkbox or radio button.

    Example: click on the word "bees", whose label contains a checkbox. The browser sends a second click event to the
    checkbox. Result: CLICK on the checkbox.
    """
    target = gesture.label_target
    return target if target is not None and target.tag in TOGGLE_TAGS else None
