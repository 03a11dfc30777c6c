"""Resolves a click on a container to the leaf element that the person meant, because policies click leaves only.

`LEAF_RULES` are tried in order. The first rule that finds a leaf decides. A click outside all rows of the page has the
row NO_ROW; for it, the leaves are those of the whole page.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from browser_farm.human.gesture_context import NO_ROW, TOGGLE_TAGS, GestureContext
from browser_farm.human.gestures import UnsupportedRecording

CONTROL_TAGS = frozenset({"a", "button", "label", "li", "span", "td"})  # clicked as a whole, whatever is inside

Box = tuple[float, float, float, float]  # left, top, width, height in CSS px
LeafRule = Callable[[GestureContext, int], int | None]


def flipped_checkbox(context: GestureContext, container: int) -> int | None:
    """The only checkbox in the container that changed, or the only radio button that was switched on.

    Example: click on the label "bees", whose checkbox changes without a click event of its own. Result: CLICK on the
    checkbox.
    """
    flipped = [leaf for leaf in _checkboxes(context, container) if context.flipped(context.screen.nodes[leaf])]
    return flipped[0] if len(flipped) == 1 else None


def only_checkbox_at_the_end(context: GestureContext, container: int) -> int | None:
    """The only checkbox in the container, if this click ended the episode.

    Example (task click-widget): the last click is on the container of a checkbox, and the recording stops before the
    checkbox changes. Result: CLICK on the checkbox.
    """
    checkboxes = _checkboxes(context, container)
    return checkboxes[0] if container != NO_ROW and context.is_last and len(checkboxes) == 1 else None


def only_leaf(context: GestureContext, container: int) -> int | None:
    """The only leaf in the container.

    Example (task click-collapsible): click on the header of a section, an <h3> with one line of text. Result: CLICK on
    the text.
    """
    leaves = context.screen.leaves_below(container)
    return leaves[0] if container != NO_ROW and len(leaves) == 1 else None


def leaf_under_the_mouse(context: GestureContext, container: int) -> int | None:
    """The smallest leaf in the container whose box contains the mouse position.

    Example (task click-dialog): click on the icon of the close button, which also has a text. Result: CLICK on the
    icon.
    """
    x, y = _mouse_position(context)
    boxes = [(leaf, context.screen.nodes[leaf].box) for leaf in context.screen.leaves_below(container)]
    hits = [(box[2] * box[3], leaf) for leaf, box in boxes if _contains(box, x, y)]
    return min(hits)[1] if hits else None


def nearest_leaf_of_a_control(context: GestureContext, container: int) -> int | None:
    """The leaf nearest to the mouse, if the container is a control that is clicked as a whole.

    Example (task email-inbox-forward-nl): click on the edge of the Forward button, outside its icon and its text.
    Result: CLICK on the nearer of the two.
    """
    leaves = context.screen.leaves_below(container)
    if container == NO_ROW or context.screen.nodes[container].tag not in CONTROL_TAGS or not leaves:
        return None
    x, y = _mouse_position(context)
    return min(leaves, key=lambda leaf: _distance(context.screen.nodes[leaf].box, x, y))


def container_of_a_failure(context: GestureContext, container: int) -> int | None:
    """The container itself, if the recording is a failure. Failures show what was done, also what policies cannot do.

    Example: the last click is on an empty part of the page, and the reward is -1. Result: CLICK on the container.
    """
    return container if container != NO_ROW and not context.strict else None


LEAF_RULES: tuple[LeafRule, ...] = (
    flipped_checkbox,
    only_checkbox_at_the_end,
    only_leaf,
    leaf_under_the_mouse,
    nearest_leaf_of_a_control,
    container_of_a_failure,
)


def resolve_leaf(context: GestureContext, container: int) -> int:
    """The row to click for a click on `container`. UnsupportedRecording if no rule finds one."""
    for rule in LEAF_RULES:
        leaf = rule(context, container)
        if leaf is not None:
            return leaf
    raise UnsupportedRecording("click outside the task" if container == NO_ROW else "click on a container")


def _checkboxes(context: GestureContext, container: int) -> list[int]:
    leaves = context.screen.leaves_below(container)
    return [leaf for leaf in leaves if context.screen.nodes[leaf].tag in TOGGLE_TAGS]


def _mouse_position(context: GestureContext) -> tuple[float, float]:
    state = context.states[context.gesture.start]
    return state.x, state.y


def _contains(box: Box, x: float, y: float) -> bool:
    return box[0] <= x <= box[0] + box[2] and box[1] <= y <= box[1] + box[3]


def _distance(box: Box, x: float, y: float) -> float:
    """Distance of a point to the nearest point of a box, px."""
    return math.hypot(max(box[0] - x, 0.0, x - box[0] - box[2]), max(box[1] - y, 0.0, y - box[1] - box[3]))
