"""Converts the DOM trees inside recordings to the page tables that reading.js produces in Chrome."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import Page

MAX_ROWS = 5_000  # recorded pages have at most 127 nodes; Page.parent is int16
MAX_DEPTH = 100  # recorded pages nest about ten deep; the limit keeps hostile files from overflowing the stack
SCROLLED_PX = 8.0  # the content of a container is scrolled if it begins this far above the container
MAX_NUMBER = 1e6
# Elements that are left out with everything in them.
HIDDEN_TAGS = frozenset({"br", "script", "style", "head", "link", "meta", "title", "template", "noscript"})
HIDDEN_IDS = frozenset({"query", "reward-display", "sync-task-cover", "click-canvas", "attention-canvas"})
# Text for screen readers. It names the option below the mouse, which reveals a person's next action.
HIDDEN_CLASS = "ui-helper-hidden-accessible"
UNWRAPPED_IDS = frozenset({"wrap", "mturk_form"})  # left out, but their children are rows
TEXT_TAG = "t"
CONTROL_TAGS = ("button", "input", "textarea", "select")  # prefixes of tags that have the browser's own colour
TRANSPARENT = frozenset({"", "transparent", "rgba(0, 0, 0, 0)"})
SHAPES = {"polygon": "triangle", "rect": "rectangle", "circle": "circle"}  # recorded pages have no other polygons
VALUE_TAGS = ("input", "textarea")  # prefixes of tags that show their value instead of text


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One element, or one line of bare text, of a recorded page, with its children."""

    tag: str  # lower case; inputs as "input_text"; "t" is a line of bare text
    id: str
    ref: int  # constant throughout a recording for elements; another one in every state for bare text
    text: str  # white space collapsed, "" except on leaves
    value: str  # value of a field; "checked" or "" for a checkbox or radio button
    classes: str
    colour: str  # CSS colour of the background, "" if transparent
    box: tuple[float, float, float, float]  # left, top, width, height in CSS px
    focused: bool
    target: bool  # target of the recorded event
    children: tuple[Node, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Screen:
    """A recorded page as a table of E rows in document order."""

    nodes: tuple[Node, ...]  # [E]
    parents: tuple[int, ...]  # [E] row of the nearest ancestor that is a row, -1 for none
    row_of: dict[int, int]  # ref -> row, elements only

    def page(self, tampered: Collection[int]) -> Page:
        """The page as policies see it. `tampered` contains the refs of the elements acted on so far."""
        nodes = self.nodes
        return Page(
            tag=tuple(node.tag for node in nodes),
            text=tuple(node.text for node in nodes),
            value=tuple(node.value for node in nodes),
            classes=tuple(node.classes for node in nodes),
            attributes=tuple(node.id for node in nodes),
            colour=tuple(
                node.colour if self.is_leaf(row) and not node.text and not node.tag.startswith(CONTROL_TAGS) else ""
                for row, node in enumerate(nodes)
            ),
            shape=tuple(SHAPES.get(node.tag, "") for node in nodes),
            ref=np.array([node.ref for node in nodes], dtype=np.int32),
            parent=np.array(self.parents, dtype=np.int16),
            box=self._unscrolled(),
            focused=np.array([node.focused for node in nodes], dtype=np.bool_),
            tampered=np.array([node.ref in tampered for node in nodes], dtype=np.bool_),
        )

    def _unscrolled(self) -> NDArray[np.float32]:
        """[E, 4] the boxes before scrolling. A person scrolls to the next target, so scrolled boxes would reveal it."""
        boxes = np.array([node.box for node in self.nodes], dtype=np.float32).reshape(len(self.nodes), 4)
        shift = np.zeros(len(boxes), dtype=np.float32)
        scrolled: dict[int, float] = {}  # row -> px by which its children are scrolled up
        for row, parent in enumerate(self.parents):
            if parent < 0:
                continue
            if parent not in scrolled:  # `row` is its first child
                above = float(boxes[parent, 1] - boxes[row, 1])
                scrolled[parent] = above if above > SCROLLED_PX else 0.0
            shift[row] = shift[parent] + scrolled[parent]
        boxes[:, 1] += shift
        return boxes

    def same_except_focus(self, other: Screen, *, compare_boxes: bool = True) -> bool:
        """Whether two pages are equal except for the focus, and except for positions if compare_boxes=False."""
        return self.parents == other.parents and all(
            (a.tag, a.text, a.value, a.classes) == (b.tag, b.text, b.value, b.classes)
            and (a.box == b.box or not compare_boxes)
            for a, b in zip(self.nodes, other.nodes, strict=True)
        )

    def leaves_below(self, row: int) -> list[int]:
        """The descendants of `row` without children, ascending. Row -1 means the whole page."""
        inner = set(self.parents)
        below = {row}
        for child, parent in enumerate(self.parents):
            if parent in below:
                below.add(child)
        return sorted(child for child in below - {row} if child not in inner)

    def acted_ref(self, row: int) -> int:
        """The ref of the element that receives an action on `row`: for bare text, its parent."""
        bare = self.nodes[row].tag == TEXT_TAG and self.parents[row] >= 0
        return self.nodes[self.parents[row] if bare else row].ref

    def is_leaf(self, row: int) -> bool:
        """Whether a row has no children."""
        return row not in self.parents


def flatten(body: Node) -> Screen:
    """The page as a table: the visible elements below <body>, without the instruction and MiniWoB's own overlays.

    ValueError for more than MAX_ROWS rows.
    """
    nodes: list[Node] = []
    parents: list[int] = []

    def walk(children: Sequence[Node], parent: int) -> None:
        for node in children:
            if node.tag in HIDDEN_TAGS or node.id in HIDDEN_IDS or HIDDEN_CLASS in node.classes:
                continue
            if node.id in UNWRAPPED_IDS:
                walk(node.children, parent)
                continue
            nodes.append(node)
            parents.append(parent)
            walk(node.children, len(nodes) - 1)

    walk(body.children, -1)
    if len(nodes) > MAX_ROWS:
        raise ValueError(f"a page has {len(nodes)} elements, wanted at most {MAX_ROWS}")
    row_of = {node.ref: row for row, node in enumerate(nodes) if node.tag != TEXT_TAG}
    return Screen(nodes=tuple(nodes), parents=tuple(parents), row_of=row_of)


def parse_node(raw: object, where: str, depth: int = 0) -> Node:
    """Validate one recorded DOM node and its descendants. `where` names it in error messages. ValueError if invalid."""
    if not isinstance(raw, dict):
        raise ValueError(f"{where} is {_describe(raw)}, wanted a DOM node (an object)")
    if depth > MAX_DEPTH:
        raise ValueError(f"{where} is nested more than {MAX_DEPTH} nodes deep, wanted a recorded page")
    tag, ref = raw.get("tag"), raw.get("ref")
    if not isinstance(tag, str) or not tag:
        raise ValueError(f"{where}: the tag is {_describe(tag)}, wanted an element name")
    if isinstance(ref, bool) or not isinstance(ref, int) or abs(ref) >= 1 << 31:
        raise ValueError(f"{_describe_key(raw, 'ref', where)} is {_describe(ref)}, wanted a 32-bit integer")
    children = raw.get("children", [])
    if not isinstance(children, list):
        raise ValueError(f"{_describe_key(raw, 'children', where)} is {_describe(children)}, wanted a list")
    value = raw.get("value", "")
    if not isinstance(value, (str, bool)):
        raise ValueError(f"{_describe_key(raw, 'value', where)} is {_describe(value)}, wanted text, true or false")
    return Node(
        tag=tag.lower(),
        id=_text(raw, "id", where),
        ref=ref,
        text="" if children or tag.lower().startswith(VALUE_TAGS) else " ".join(_text(raw, "text", where).split()),
        value=("checked" if value else "") if isinstance(value, bool) else value,
        colour=colour if (colour := str(raw.get("bgColor") or "")) not in TRANSPARENT else "",
        # SVG elements have {}.
        classes="" if isinstance(raw.get("classes"), dict) else _without_hover(_text(raw, "classes", where)),
        box=(
            read_number(raw, "left", where),
            read_number(raw, "top", where),
            read_number(raw, "width", where),
            read_number(raw, "height", where),
        ),
        focused=raw.get("focused") is True,
        target=raw.get("recordingTarget") is True,
        children=tuple([parse_node(child, where, depth + 1) for child in children]),
    )


def target_of(node: Node) -> Node | None:
    """The node that was the target of the recorded event, None if there is none."""
    if node.target:
        return node
    for child in node.children:
        found = target_of(child)
        if found is not None:
            return found
    return None


def read_number(raw: Mapping[str, object], key: str, where: str, default: object = None) -> float:
    """The number under a key. ValueError if it is no number, or larger than MAX_NUMBER in size."""
    value = raw.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not -MAX_NUMBER <= value <= MAX_NUMBER:
        raise ValueError(
            f"{_describe_key(raw, key, where)} is {_describe(value)}, wanted a number of at most {MAX_NUMBER:.0e}"
        )
    return float(value)


def _without_hover(classes: str) -> str:
    """The classes without those of elements below the mouse, which would reveal what a person clicks next."""
    names = [name for name in classes.split(" ") if "hover" not in name]
    if "ui-menu-item-wrapper" in names:
        names = [name for name in names if name != "ui-state-active"]
    return " ".join(names)


def _text(raw: Mapping[str, object], key: str, where: str) -> str:
    value = raw.get(key, "")
    if not isinstance(value, str):
        raise ValueError(f"{_describe_key(raw, key, where)} is {_describe(value)}, wanted text")
    return value


def _describe_key(raw: Mapping[str, object], key: str, where: str) -> str:
    """Names a value in error messages. Built only for errors, because a recording has 100,000 numbers."""
    return f"{where}: {key} of {str(raw.get('tag') or raw.get('type') or 'an object')[:20]!r}"


def _describe(value: object) -> str:
    return "missing" if value is None else f"{type(value).__name__} {str(value)[:40]!r}"
