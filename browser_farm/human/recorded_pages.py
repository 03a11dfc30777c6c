"""Turns the DOM trees inside recordings into the same page tables that Chrome's walk gives."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from giirl_core.types import Page

MOST_ROWS = 5_000  # far above any recorded page (127 nodes) and below what Page.parent can number
DEEPEST_NODE = 100  # recorded pages nest about ten deep; the limit keeps a hostile file off the stack
FARTHEST_PX = 1e6
UNSEEN_TAGS = frozenset(
    {"br", "script", "style", "head", "link", "meta", "title", "template", "noscript"}
)  # with all that is in them
UNSEEN_IDS = frozenset({"query", "reward-display", "sync-task-cover", "click-canvas", "attention-canvas"})
LIFTED_IDS = frozenset({"wrap", "mturk_form"})  # no rows themselves, their children are
TEXT_TAG = "t"
WORDLESS = ("input", "textarea")  # what they show is their value


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """One element, or one line of bare text, of a recorded page."""

    tag: str  # lower case; inputs as "input_text"; "t" is a line of bare text
    id: str
    ref: int  # elements keep theirs throughout a recording, bare text gets another in every state
    text: str  # white space collapsed, "" except on leaves
    value: str  # what a field holds, "checked" or "" for a checkbox or radio button
    classes: str
    box: tuple[float, float, float, float]  # left, top, width, height in CSS px
    focused: bool
    target: bool  # the recorded event was aimed at it
    children: tuple[Node, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Screen:
    """A recorded page flattened to rows in document order."""

    nodes: tuple[Node, ...]  # [E]
    parents: tuple[int, ...]  # [E] row of the nearest ancestor that is a row, -1 for none
    row_of: dict[int, int]  # ref -> row, elements only

    def page(self, tampered: Collection[int]) -> Page:
        """The table a policy sees; `tampered` holds the refs acted upon so far."""
        nodes = self.nodes
        return Page(
            tag=tuple(node.tag for node in nodes),
            text=tuple(node.text for node in nodes),
            value=tuple(node.value for node in nodes),
            classes=tuple(node.classes for node in nodes),
            ref=np.array([node.ref for node in nodes], dtype=np.int32),
            parent=np.array(self.parents, dtype=np.int16),
            box=np.array([node.box for node in nodes], dtype=np.float32).reshape(len(nodes), 4),
            focused=np.array([node.focused for node in nodes], dtype=np.bool_),
            tampered=np.array([node.ref in tampered for node in nodes], dtype=np.bool_),
        )

    def same_but_focus(self, other: Screen, *, boxes: bool = True) -> bool:
        """Whether nothing but the focus differs, and the boxes where those do not count."""
        return self.parents == other.parents and all(
            (a.tag, a.text, a.value, a.classes) == (b.tag, b.text, b.value, b.classes) and (a.box == b.box or not boxes)
            for a, b in zip(self.nodes, other.nodes, strict=True)
        )

    def leaves_below(self, row: int) -> list[int]:
        """The rows below `row` that have no rows below themselves; of the whole page for row -1."""
        inner = set(self.parents)
        below = {row}
        for child, parent in enumerate(self.parents):
            if parent in below:
                below.add(child)
        return sorted(child for child in below - {row} if child not in inner)

    def touched(self, row: int) -> int:
        """The ref of the element that an action on `row` reaches: for bare text, the one it stands in."""
        bare = self.nodes[row].tag == TEXT_TAG and self.parents[row] >= 0
        return self.nodes[self.parents[row] if bare else row].ref

    def is_leaf(self, row: int) -> bool:
        return row not in self.parents


def flatten(body: Node) -> Screen:
    """The rows of a page: what is visible below <body> but the instruction and the page's furniture."""
    nodes: list[Node] = []
    parents: list[int] = []

    def walk(children: Sequence[Node], parent: int) -> None:
        for node in children:
            if node.tag in UNSEEN_TAGS or node.id in UNSEEN_IDS:
                continue
            if node.id in LIFTED_IDS:
                walk(node.children, parent)
                continue
            nodes.append(node)
            parents.append(parent)
            walk(node.children, len(nodes) - 1)

    walk(body.children, -1)
    if len(nodes) > MOST_ROWS:
        raise ValueError(f"a page has {len(nodes)} elements, wanted at most {MOST_ROWS}")
    row_of = {node.ref: row for row, node in enumerate(nodes) if node.tag != TEXT_TAG}
    return Screen(nodes=tuple(nodes), parents=tuple(parents), row_of=row_of)


def parse_node(raw: object, where: str, depth: int = 0) -> Node:
    """Check one recorded DOM node and everything below it."""
    if not isinstance(raw, dict):
        raise ValueError(f"{where} is {_kind(raw)}, wanted a DOM node (an object)")
    if depth > DEEPEST_NODE:
        raise ValueError(f"{where} nests deeper than {DEEPEST_NODE} nodes")
    tag, ref = raw.get("tag"), raw.get("ref")
    if not isinstance(tag, str) or not tag:
        raise ValueError(f"{where}: the tag of a node is {_kind(tag)}, wanted the name of an element")
    if isinstance(ref, bool) or not isinstance(ref, int) or abs(ref) >= 1 << 31:
        raise ValueError(f"{_place(raw, 'ref', where)} is {_kind(ref)}, wanted a whole number of 32 bits")
    children = raw.get("children", [])
    if not isinstance(children, list):
        raise ValueError(f"{_place(raw, 'children', where)} is {_kind(children)}, wanted a list")
    value = raw.get("value", "")
    if not isinstance(value, (str, bool)):
        raise ValueError(f"{_place(raw, 'value', where)} is {_kind(value)}, wanted text or true or false")
    return Node(
        tag=tag.lower(),
        id=_text(raw, "id", where),
        ref=ref,
        text="" if children or tag.lower().startswith(WORDLESS) else " ".join(_text(raw, "text", where).split()),
        value=("checked" if value else "") if isinstance(value, bool) else value,
        classes="" if isinstance(raw.get("classes"), dict) else _text(raw, "classes", where),  # SVG's own {}
        box=(
            measure(raw, "left", where),
            measure(raw, "top", where),
            measure(raw, "width", where),
            measure(raw, "height", where),
        ),
        focused=raw.get("focused") is True,
        target=raw.get("recordingTarget") is True,
        children=tuple([parse_node(child, where, depth + 1) for child in children]),
    )


def target_of(node: Node) -> Node | None:
    """The node that the event of this state was aimed at, None where that is not part of the page."""
    if node.target:
        return node
    for child in node.children:
        found = target_of(child)
        if found is not None:
            return found
    return None


def measure(raw: Mapping[str, object], key: str, where: str, default: object = None) -> float:
    """A length or position in CSS px, or another number of that size."""
    value = raw.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not -FARTHEST_PX <= value <= FARTHEST_PX:
        raise ValueError(f"{_place(raw, key, where)} is {_kind(value)}, wanted a number, at most {FARTHEST_PX:.0e}")
    return float(value)


def _text(raw: Mapping[str, object], key: str, where: str) -> str:
    value = raw.get(key, "")
    if not isinstance(value, str):
        raise ValueError(f"{_place(raw, key, where)} is {_kind(value)}, wanted text")
    return value


def _place(raw: Mapping[str, object], key: str, where: str) -> str:
    """Put together only when it is needed: a recording has 100,000 numbers."""
    return f"{where}: {key} of {str(raw.get('tag') or raw.get('type') or 'an object')[:20]!r}"


def _kind(value: object) -> str:
    return "missing" if value is None else f"{type(value).__name__} {str(value)[:40]!r}"
