"""Infers the actions of a person from the gestures of a recording: clicks on leaf elements, and typing into fields.

`KEY_RULES` apply to gestures with the keyboard, `MOUSE_RULES` to clicks. The rules of a table are tried in order, and
the first rule that applies decides. A rule returns the action; or IGNORED, if the gesture is not an action; or None, if
the rule does not apply. It raises UnsupportedRecording if policies have no such action. The docstring of each rule
gives an example.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import Enum
from typing import Final, Literal

from browser_farm.human.gesture_context import TOGGLE_TAGS, GestureContext, InferredAction
from browser_farm.human.gestures import TAB, Gesture, GestureKind, RecordedState, UnsupportedRecording, gestures_of
from browser_farm.human.leaf_rules import resolve_leaf
from browser_farm.human.recorded_pages import Node
from giirl_core.types import TYPABLE_TAGS, Verb

ENTER = 13
NATIVE_LIST_TAGS = frozenset({"select", "option"})


class Verdict(Enum):
    """A decision of a rule that is not an action."""

    IGNORED = 1


IGNORED: Final = Verdict.IGNORED
Decision = InferredAction | Literal[Verdict.IGNORED]
Rule = Callable[[GestureContext], Decision | None]


def infer_actions(states: Sequence[RecordedState], *, strict: bool = True) -> list[InferredAction]:
    """The person's actions in order, each with the page on which it was decided.

    `strict` is for demonstrations. With strict=False, for failed episodes, a click may stay on a container, and the
    checkbox states need not be reproduced. UnsupportedRecording if the recording needs actions that policies lack.
    """
    actions: list[InferredAction] = []
    idle_since: int | None = None  # state in which ignored gestures began that left the page as it was
    gestures = gestures_of(states)
    for index, gesture in enumerate(gestures):
        context = GestureContext(
            states=states,
            gesture=gesture,
            following=gestures[index + 1] if index + 1 < len(gestures) else None,
            before=_decision_state(states, gesture, idle_since),
            strict=strict,
        )
        decision = decide(context)
        if isinstance(decision, InferredAction):
            idle_since = None
            _append(actions, decision)
        else:
            idle_since = context.before if _keeps_decision_page(context) else None
    if not actions:
        raise UnsupportedRecording("no action")
    if strict:
        check_checkboxes(states, actions)
    return actions


def decide(context: GestureContext) -> Decision:
    """The decision of the first rule that applies."""
    for rule in KEY_RULES if context.gesture.kind is GestureKind.KEYS else MOUSE_RULES:
        decision = rule(context)
        if decision is not None:
            return decision
    raise AssertionError("the last rule of each table always decides")


# ---- rules for both


def native_list(context: GestureContext) -> None:
    """Native lists are refused, because recordings do not show which option was chosen.

    Example: click on a <select>. Result: UnsupportedRecording.
    """
    nodes = (context.gesture.down, context.gesture.target)
    if any(node is not None and node.tag in NATIVE_LIST_TAGS for node in nodes):
        raise UnsupportedRecording("native list")


# ---- rules for the keyboard


def key_that_clicks(context: GestureContext) -> Decision | None:
    """A key that produces a click event is ignored. The click event is the action.

    Example: Enter on the focused Submit button. Result: CLICK on Submit, by the gesture that follows.
    """
    return IGNORED if _produces_click(context) else None


def typing(context: GestureContext) -> Decision | None:
    """Keys that change a field are typing: its new value is the text. This includes paste with Ctrl-V.

    Example: keys A d a in an empty field. Result: TYPE "Ada". Not if Enter ends the episode, see `unsupported_key`.
    """
    action = context.typed_into(context.gesture.down)
    enter_ends_episode = context.is_last and ENTER in context.gesture.key_codes
    return None if enter_ends_episode else action


def tab_key(context: GestureContext) -> Decision | None:
    """Tab is ignored. It moves the focus, and so does the click or the typing that follows.

    Example: type "Ada", Tab, type "pass". Result: TYPE "Ada" and TYPE "pass" in the next field.
    """
    return IGNORED if TAB in context.gesture.key_codes and not context.is_last else None


def keys_without_effect(context: GestureContext) -> Decision | None:
    """Keys that change nothing on the page but positions are ignored.

    Example: Ctrl-C copies a text. An arrow key scrolls the page.
    """
    return IGNORED if not context.is_last and context.page_unchanged(compare_boxes=False) else None


def unsupported_key(context: GestureContext) -> Decision | None:
    """All other keys are refused, because policies have no such action.

    Example: Enter in a text field submits the form.
    """
    raise UnsupportedRecording("unsupported key")


KEY_RULES: tuple[Rule, ...] = (
    key_that_clicks,
    native_list,
    typing,
    tab_key,
    keys_without_effect,
    unsupported_key,
)


# ---- rules for the mouse


def value_changed_by_mouse(context: GestureContext) -> Decision | None:
    """A mouse gesture that changes the value of its field is typing.

    Example: paste "Ada" with the context menu. Result: TYPE "Ada". Other cases are the arrows of a number field
    (task guess-number) and Chrome's own calendar (task enter-date).
    """
    return context.typed_into(context.clicked)


def focus_click(context: GestureContext) -> Decision | None:
    """A click that only focuses a text field is ignored, because typing focuses the field by itself.

    Example: click on the field, type "Ada". Result: TYPE "Ada", decided on the page before the click. If the click ends
    the episode, as in the task focus-text, it is an action.
    """
    if context.is_last or not context.clicks_leaf:
        return None
    on_field = context.screen.nodes[context.clicked_row].tag in TYPABLE_TAGS
    return IGNORED if on_field and context.page_unchanged() else None


def press_without_effect(context: GestureContext) -> Decision | None:
    """A mouse press without a click event is ignored if it changes nothing.

    Example (task click-button): mouse down on the button "ok", mouse up outside all buttons.
    """
    if context.is_last or not context.clicks_leaf or context.gesture.kind is not GestureKind.PRESS:
        return None
    return IGNORED if context.page_unchanged() else None


def wasted_click(context: GestureContext) -> Decision | None:
    """A click on a container is ignored if the page does not react, unless it ends the episode.

    Example: click on an empty part of the page. Pull a scroll bar: elements move, but no handler reacted.
    """
    if context.is_last or context.clicks_leaf:
        return None
    return IGNORED if not context.page_reacted() or context.page_unchanged() else None


def drag(context: GestureContext) -> Decision | None:
    """A drag that changes the page is refused.

    Example: mouse down on the first item of a sortable list, mouse up on the second.
    """
    is_press = context.gesture.kind is GestureKind.PRESS
    if is_press and not context.is_last and _ref(context.gesture.down) != _ref(context.clicked):
        raise UnsupportedRecording("drag")
    return None


def click_on_leaf(context: GestureContext) -> Decision | None:
    """A click on a leaf is an action on the page before the mouse went down.

    Example: click on the button "No". Result: CLICK on "No". A click on a label counts as a click on its checkbox, see
    `gesture_context.checkbox_of_label`.
    """
    return context.click(context.clicked_row) if context.clicks_leaf else None


def click_in_container(context: GestureContext) -> Decision | None:
    """A click on a container is a click on one of its leaves, chosen by `leaf_rules.LEAF_RULES`.

    Example: click on the text "two" of a <div>. Result: CLICK on "two".
    """
    return context.click(resolve_leaf(context, context.clicked_row))


MOUSE_RULES: tuple[Rule, ...] = (
    native_list,
    value_changed_by_mouse,
    focus_click,
    press_without_effect,
    wasted_click,
    drag,
    click_on_leaf,
    click_in_container,
)


# ---- rules for the sequence of actions


def _decision_state(states: Sequence[RecordedState], gesture: Gesture, idle_since: int | None) -> int:
    """The state whose page the person saw when deciding.

    After ignored gestures it is the state before them, since a policy does not make them. Example: the page before a
    focus click, not the page with the focused field. If the target did not exist yet, it is the gesture's own state.
    """
    if idle_since is None or _ref(gesture.target) not in states[idle_since].screen.row_of:
        return gesture.start
    return idle_since


def _keeps_decision_page(context: GestureContext) -> bool:
    """Whether the next action counts as decided on the page before this ignored gesture.

    True if a policy, which does not make the gesture, would still see that page.
    """
    return _produces_click(context) or TAB in context.gesture.key_codes or context.page_unchanged()


def _append(actions: list[InferredAction], action: InferredAction) -> None:
    """Append an action; continued typing in the same field becomes one action with the final text.

    Example: type "Ada", click into the field, type " Lovelace". Result: one TYPE "Ada Lovelace".
    """
    if actions and action.verb is Verb.TYPE and actions[-1].verb is Verb.TYPE and actions[-1].ref == action.ref:
        actions[-1] = replace(actions[-1], text=action.text)
    else:
        actions.append(action)


def check_checkboxes(states: Sequence[RecordedState], actions: Sequence[InferredAction]) -> None:
    """The inferred clicks must reproduce the recorded checkbox states, otherwise the recording is refused.

    Between two actions, the clicked checkbox must change and no other; a clicked radio button must be on. Example: a
    click on "bees" after which "cats" is checked too. UnsupportedRecording.
    """
    for action, following in itertools.pairwise([None, *actions]):
        assert following is not None
        earlier = states[0 if action is None else action.state].screen
        later = states[following.state].screen
        for node in earlier.nodes:
            if node.tag not in TOGGLE_TAGS or node.ref not in later.row_of:
                continue
            value = later.nodes[later.row_of[node.ref]].value
            if not _reproduced(node, value, clicked=action is not None and node.ref == action.ref):
                raise UnsupportedRecording("checkbox states not reproduced")


def _reproduced(node: Node, value: str, *, clicked: bool) -> bool:
    if node.tag == "input_checkbox":
        return clicked == (value != node.value)
    return not clicked or value == "checked"


def _produces_click(context: GestureContext) -> bool:
    gesture, following = context.gesture, context.following
    return (
        gesture.kind is GestureKind.KEYS
        and following is not None
        and following.kind is GestureKind.KEY_CLICK
        and _ref(following.target) == _ref(gesture.down)
    )


def _ref(node: Node | None) -> int | None:
    return None if node is None else node.ref
