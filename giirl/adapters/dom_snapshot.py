"""The answer of Chrome to `DOMSnapshot.captureSnapshot`, which BrowserGym calls `dom_object`, as rows of a page."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

ELEMENT, TEXT = 1, 3  # Node.nodeType
BID = "bid"  # the attribute with BrowserGym's name of an element
NON_TASK_IDS = {"query", "reward-display", "sync-task-cover", "click-canvas", "attention-canvas"}  # of MiniWoB
WRAP_ID = "wrap"  # the element around everything on MiniWoB's pages
INVISIBLE_TAGS = frozenset(["script", "style", "br", "head", "link", "meta", "title", "template", "noscript"])
DESCRIBING = ("id", "placeholder", "alt", "aria-label")
COLOURING = ("background-color", "fill", "color")  # in an element's own style
LINE_PX = 1.0  # text boxes whose tops differ by at most this are in one line


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """An element, or a line of bare text."""

    tag: str
    box: Sequence[float]  # left, top, width, height in CSS px
    parent: int = -1
    text: str = ""
    value: str = ""
    classes: str = ""
    colour: str = ""
    attributes: str = ""
    bid: str = ""


class _Snapshot:
    """The first document of the answer to `DOMSnapshot.captureSnapshot`."""

    def __init__(self, snapshot: Mapping[str, Any]) -> None:
        self._strings: Sequence[str] = snapshot["strings"]
        document = snapshot["documents"][0]
        self.nodes, layout = document["nodes"], document["layout"]
        self.children: dict[int, list[int]] = {}
        for node, parent in enumerate(self.nodes["parentIndex"]):
            self.children.setdefault(parent, []).append(node)
        left, top = document["scrollOffsetX"], document["scrollOffsetY"]
        self._offset = np.array([left, top, 0, 0], dtype=np.float64)
        self._layouts = {node: index for index, node in enumerate(layout["nodeIndex"])}
        self._bounds, self._texts, boxes = layout["bounds"], layout["text"], document["textBoxes"]
        self._lines: dict[int, list[tuple[Any, int, int]]] = {}  # of a layout: bounds, start and length of its text
        lines = zip(boxes["bounds"], boxes["start"], boxes["length"], strict=True)
        for index, line in zip(boxes["layoutIndex"], lines, strict=True):
            self._lines.setdefault(index, []).append(line)
        self._selected = set(self.nodes["optionSelected"]["index"])
        self._checked = set(self.nodes["inputChecked"]["index"])

    def string(self, index: int) -> str:
        return self._strings[index] if index >= 0 else ""

    def tag(self, node: int) -> str:
        return self.string(self.nodes["nodeName"][node]).lower()

    def kind(self, node: int) -> int:
        return int(self.nodes["nodeType"][node])

    def attributes(self, node: int) -> dict[str, str]:
        found = self.nodes["attributes"][node]
        return {self.string(name): self.string(value) for name, value in zip(found[::2], found[1::2], strict=True)}

    def elements(self, node: int) -> list[int]:
        return [child for child in self.children.get(node, ()) if self.kind(child) == ELEMENT]

    def box(self, node: int) -> list[float] | None:
        """Left, top, width and height in the window; None for what is not drawn."""
        index = self._layouts.get(node)
        return None if index is None else (np.array(self._bounds[index]) - self._offset).tolist()

    def lines(self, node: int) -> list[tuple[str, list[float]]]:
        """The text of each line of a text node, and its box."""
        index = self._layouts.get(node, -1)
        text = self.string(self._texts[index]) if index >= 0 else ""
        lines: list[tuple[str, list[float]]] = []
        for bounds, start, length in self._lines.get(index, ()):
            words, box = text[start : start + length], (np.array(bounds) - self._offset).tolist()
            if not words.strip() or box[2] <= 0 or box[3] <= 0:
                continue
            if lines and abs(lines[-1][1][1] - box[1]) <= LINE_PX:
                last, (left, top, _, height) = lines[-1]
                lines[-1] = (f"{last}{words}", [left, top, box[0] + box[2] - left, height])
            else:
                lines.append((words, box))
        return [(_collapse(words), box) for words, box in lines]

    def content(self, node: int) -> str:
        """All text in a node."""
        if self.kind(node) == TEXT:
            return self.string(self.nodes["nodeValue"][node])
        return "".join(self.content(child) for child in self.children.get(node, ()))

    def value(self, node: int, tag: str, attributes: Mapping[str, str]) -> str:
        """The value of a field, which BrowserGym keeps in an attribute; "checked" of a checked box or chosen option."""
        if tag in ("input_checkbox", "input_radio"):
            return "checked" if node in self._checked or "checked" in attributes else ""
        if tag == "option":
            return "checked" if node in self._selected else ""
        return attributes.get("value", "") if tag.startswith("input") or tag in ("textarea", "select") else ""


def read_rows(snapshot: Mapping[str, Any]) -> list[Row]:
    """The visible elements of the first document, and its bare text, in document order. ValueError if it is damaged."""
    try:
        reader = _Reader(_Snapshot(snapshot))
        reader.read()
    except (LookupError, TypeError, AttributeError, StopIteration) as error:
        raise ValueError(f"dom_object is no DOM snapshot with a body: {type(error).__name__} {error}") from error
    return reader.rows


@dataclass(frozen=True, slots=True)
class _Reader:
    """Reads a snapshot as the farm reads its own pages (browser_farm/js/reading.js)."""

    snapshot: _Snapshot
    rows: list[Row] = field(default_factory=list)

    def read(self) -> None:
        body = next(node for node in range(len(self.snapshot.nodes["nodeName"])) if self.snapshot.tag(node) == "body")
        self._read_children(body, -1)

    def _read_children(self, node: int, parent: int) -> None:
        for child in self.snapshot.children.get(node, ()):
            if self.snapshot.kind(child) == ELEMENT:
                self._read(child, parent)
            elif self.snapshot.kind(child) == TEXT:
                lines = self.snapshot.lines(child)
                self.rows.extend(Row(tag="t", text=text, box=box, parent=parent) for text, box in lines)

    def _read(self, node: int, parent: int) -> None:
        name, attributes, box = self.snapshot.tag(node), self.snapshot.attributes(node), self.snapshot.box(node)
        if name in INVISIBLE_TAGS or attributes.get("id") in NON_TASK_IDS or box is None:
            return
        if not (box[2] and box[3]):
            self._read_children(node, parent)  # floats overflow an element without a height
            return
        tag = f"input_{attributes.get('type', 'text').lower()}" if name == "input" else name
        is_leaf = not self.snapshot.elements(node)
        if attributes.get("id") != WRAP_ID:
            text = _collapse(self.snapshot.content(node)) if is_leaf and name not in ("input", "textarea") else ""
            self.rows.append(self._row(node, tag, text, attributes, box, parent))
            parent = len(self.rows) - 1
        if name == "select":
            for option in self._options(node):
                text, its = _collapse(self.snapshot.content(option)), self.snapshot.attributes(option)
                shown = self.snapshot.box(option)
                where = shown if shown and shown[2] and shown[3] else box  # a closed list draws none of them
                self.rows.append(self._row(option, "option", text, its, where, parent))
        elif not is_leaf or attributes.get("id") == WRAP_ID:
            self._read_children(node, parent)

    def _row(
        self, node: int, tag: str, text: str, attributes: Mapping[str, str], box: Sequence[float], parent: int
    ) -> Row:
        return Row(
            tag=tag,
            text=text,
            value=self.snapshot.value(node, tag, attributes),
            classes=attributes.get("class", ""),
            colour=_colour(attributes),
            attributes=" ".join(_collapse(attributes[name]) for name in DESCRIBING if attributes.get(name)),
            box=box,
            parent=parent,
            bid=attributes.get(BID, ""),
        )

    def _options(self, node: int) -> list[int]:
        """The options of a list, also those in groups."""
        found = []
        for child in self.snapshot.elements(node):
            found += [child] if self.snapshot.tag(child) == "option" else self._options(child)
        return found


def _collapse(text: str) -> str:
    return " ".join(text.split())


def _colour(attributes: Mapping[str, str]) -> str:
    """The colour in the element's own style, or its fill."""
    style = {
        name.strip().lower(): value.strip()
        for name, _, value in (part.partition(":") for part in re.split(r";(?![^(]*\))", attributes.get("style", "")))
    }
    return next((style[name] for name in COLOURING if style.get(name)), attributes.get("fill", ""))
