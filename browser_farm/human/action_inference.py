"""Finds in recorded gestures what the person did: clicks on leaves, and texts typed into fields."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from browser_farm.human.gestures import (
    CAPTURE,
    CLICKING_KINDS,
    TAB,
    Gesture,
    Kind,
    State,
    UnsupportedRecording,
    gestures_of,
)
from browser_farm.human.recorded_pages import Node, Screen
from giirl_core.types import TYPABLE_TAGS, Verb

ENTER = 13
TOGGLES = frozenset({"input_checkbox", "input_radio"})
CONTROLS = frozenset({"a", "button", "label", "li", "span", "td"})  # one thing to click, whatever is inside
NATIVE_LISTS = frozenset({"select", "option"})  # recorders never saw which option was chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One action of the person, and the state whose page it was decided on."""

    state: int
    verb: Verb
    row: int  # of that state's screen
    ref: int
    text: str = ""


def repair(states: Sequence[State], *, strict: bool = True) -> list[Step]:
    """The person's actions in order, each with the page it was decided on.

    Strict is for demonstrations. Otherwise (for failures, which teach by what was done) a click may stay on a
    container, and checkboxes need not follow from the clicks.
    """
    gestures = gestures_of(states)
    steps: list[Step] = []
    waiting: int | None = None  # where gestures without effect began: the page is still the one from before them
    for index, gesture in enumerate(gestures):
        following = gestures[index + 1] if index + 1 < len(gestures) else None
        before = gesture.first if waiting is None else waiting
        if _ref(gesture.target) not in states[before].screen.row_of:
            before = gesture.first
        after = following.first if following else len(states) - 1
        moment = _Moment(
            states=states, gesture=gesture, before=before, after=after, last=following is None, strict=strict
        )
        presses_it = (
            gesture.kind is Kind.KEYS
            and following is not None
            and following.kind is Kind.KEY_CLICK
            and _ref(following.target) == _ref(gesture.down)
        )
        step = None if presses_it else moment.step()
        if step is None:
            waiting = before if presses_it or moment.unnoticed() else None
            continue
        waiting = None
        if steps and step.verb is Verb.TYPE and steps[-1].verb is Verb.TYPE and steps[-1].ref == step.ref:
            step = replace(steps.pop(), text=step.text)  # typed on in the same field
        steps.append(step)
    if not steps:
        raise UnsupportedRecording("no action")
    if strict:
        _check_toggles(states, steps)
    return steps


@dataclass(frozen=True, slots=True, kw_only=True)
class _Moment:
    """A gesture with the pages around it."""

    states: Sequence[State]
    gesture: Gesture
    before: int  # state that the person saw when deciding
    after: int  # state in which the next gesture begins, or the recording's last
    last: bool
    strict: bool

    def step(self) -> Step | None:
        """The action this gesture stands for, None when it had no effect."""
        aimed = (self.gesture.down, self.gesture.target)
        if any(node is not None and node.tag in NATIVE_LISTS for node in aimed):
            raise UnsupportedRecording("native list")
        return self._typed() if self.gesture.kind is Kind.KEYS else self._clicked()

    def unnoticed(self) -> bool:
        """Whether a policy, which makes no idle gestures, would still see the page from before this one."""
        return TAB in self.gesture.codes or self._inert()

    def _typed(self) -> Step | None:
        step = self._new_value(self.gesture.down)
        if TAB in self.gesture.codes and step is None and not self.last:
            return None  # it moves the focus, as the next click or text does by itself
        if (step is None and (self.last or not self._inert(boxes=False))) or (
            self.last and ENTER in self.gesture.codes
        ):
            raise UnsupportedRecording("unsupported key")
        return step

    def _clicked(self) -> Step | None:
        target = self._aim()
        if target is not None:
            pasted = self._new_value(target)  # by the mouse, or a number field's own arrows
            if pasted is not None:
                return pasted
        row = -1 if target is None else self._screen.row_of.get(target.ref, -1)
        leaf = row >= 0 and self._screen.is_leaf(row)
        on_field = leaf and self._screen.nodes[row].tag in TYPABLE_TAGS
        beside = not leaf and not self._effect()
        idle = beside or ((not leaf or on_field or self.gesture.kind is Kind.PRESS) and self._inert())
        if idle and not self.last:
            return None
        if self.gesture.kind is Kind.PRESS and not self.last and _ref(self.gesture.down) != _ref(target):
            raise UnsupportedRecording("drag")
        return self._click(row if leaf else self._leaf(row))

    def _aim(self) -> Node | None:
        gesture = self.gesture
        if gesture.relayed is not None and gesture.relayed.tag in TOGGLES:
            return gesture.relayed
        if gesture.target is None or (gesture.kind is Kind.PRESS and self.last):
            return gesture.down
        known = gesture.target.ref in self._screen.row_of
        return gesture.target if known or gesture.down is None else gesture.down

    @property
    def _screen(self) -> Screen:
        return self.states[self.before].screen

    def _inert(self, *, boxes: bool = True) -> bool:
        """Whether the page was still the same when the next gesture began; without boxes, or scrolled."""
        return self._screen.same_but_focus(self.states[self.after].screen, boxes=boxes)

    def _effect(self) -> bool:
        """Whether an event of this gesture itself changed the page, not a scroll bar or a running animation.

        The page of an event's capture phase is compared with that of its bubble phase. Where a page stopped
        the event in between, it did something with it.
        """
        for index in range(self.gesture.first, self.after):
            state, answer = self.states[index], self.states[index + 1]
            if state.kind not in CLICKING_KINDS or state.timing != CAPTURE:
                continue
            if answer.kind != state.kind or answer.timing == CAPTURE:
                return True
            if not state.screen.same_but_focus(answer.screen):
                return True
        later = self.states[self.after].screen  # browsers switch a label's checkbox after the event is over
        return any(node.tag in TOGGLES and _flipped(node, later) for node in self._screen.nodes)

    def _click(self, row: int) -> Step:
        return Step(state=self.before, verb=Verb.CLICK, row=row, ref=self._screen.nodes[row].ref)

    def _new_value(self, field: Node | None) -> Step | None:
        """Typing, seen by its effect: the field holds something else when the next gesture begins."""
        row = -1 if field is None else self._screen.row_of.get(field.ref, -1)
        if field is None or row < 0 or field.tag in TOGGLES or not field.tag.startswith(("input_", "textarea")):
            return None
        for index in range(self.after, self.gesture.first, -1):  # the field may be gone when the run is over
            screen = self.states[index].screen
            if field.ref in screen.row_of:
                text = screen.nodes[screen.row_of[field.ref]].value
                if text == self._screen.nodes[row].value:
                    return None
                if field.tag not in TYPABLE_TAGS:
                    raise UnsupportedRecording("field takes no text")
                return Step(state=self.before, verb=Verb.TYPE, row=row, ref=field.ref, text=text)
        return None

    def _leaf(self, row: int) -> int:
        """The leaf that a click on a container stands for."""
        screen, later = self._screen, self.states[self.after].screen
        leaves = screen.leaves_below(row)
        toggles = [leaf for leaf in leaves if screen.nodes[leaf].tag in TOGGLES]
        flipped = [leaf for leaf in toggles if _flipped(screen.nodes[leaf], later)]
        at = self.states[self.gesture.first]
        hit = sorted((box[2] * box[3], leaf) for leaf in leaves if _holds(box := screen.nodes[leaf].box, at.x, at.y))
        if len(flipped) == 1:
            return flipped[0]
        if row >= 0 and len(toggles) == 1 and self.last:
            return toggles[0]
        if row >= 0 and len(leaves) == 1:
            return leaves[0]
        if hit:
            return hit[0][1]
        if row >= 0 and screen.nodes[row].tag in CONTROLS and leaves:
            return min(leaves, key=lambda leaf: _distance(screen.nodes[leaf].box, at.x, at.y))
        if row >= 0 and not self.strict:
            return row
        raise UnsupportedRecording("acts on a container" if row >= 0 else "acts outside the task")


def _check_toggles(states: Sequence[State], steps: Sequence[Step]) -> None:
    """Between two actions, exactly the checkbox that was clicked may flip."""
    opening = Step(state=0, verb=Verb.CLICK, row=-1, ref=-1)
    for step, following in itertools.pairwise([opening, *steps]):
        later = states[following.state].screen
        for node in states[step.state].screen.nodes:
            if node.tag not in TOGGLES or node.ref not in later.row_of:
                continue
            clicked = step is not opening and node.ref == step.ref
            flipped = later.nodes[later.row_of[node.ref]].value != node.value
            if node.tag == "input_checkbox" and flipped != clicked:
                raise UnsupportedRecording("checkboxes do not follow")
            if clicked and later.nodes[later.row_of[node.ref]].value != "checked" and node.tag == "input_radio":
                raise UnsupportedRecording("checkboxes do not follow")


def _flipped(node: Node, later: Screen) -> bool:
    """Whether a checkbox changed, or a radio button was switched on (another always goes off with it)."""
    row = later.row_of.get(node.ref)
    value = node.value if row is None else later.nodes[row].value
    return value != node.value and (node.tag == "input_checkbox" or value == "checked")


def _holds(box: tuple[float, float, float, float], x: float, y: float) -> bool:
    return box[0] <= x <= box[0] + box[2] and box[1] <= y <= box[1] + box[3]


def _distance(box: tuple[float, float, float, float], x: float, y: float) -> float:
    """From a point to the nearest point of a box, px."""
    return math.hypot(max(box[0] - x, 0.0, x - box[0] - box[2]), max(box[1] - y, 0.0, y - box[1] - box[3]))


def _ref(node: Node | None) -> int | None:
    return None if node is None else node.ref
