"""A page as the farm reads it: its elements as columns."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

_TEXT_INPUTS = ("text", "password", "email", "search", "number", "date", "time")
TYPABLE_TAGS = frozenset({"textarea", *(f"input_{kind}" for kind in _TEXT_INPUTS)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Page:
    """The visible elements of a page at one moment: a table of E rows, one for each element, in document order.

    Raises ValueError when the columns have different lengths or a parent does not precede its child.
    """

    tag: tuple[str, ...]  # [E] lower case; inputs as "input_text"; "t" is a run of bare text
    text: tuple[str, ...]  # [E] text of a leaf, "" for other elements
    value: tuple[str, ...]  # [E] value of a form field, "" for other elements
    classes: tuple[str, ...]  # [E] space-separated
    ref: NDArray[np.int32]  # [E] the browser's handle of the element
    parent: NDArray[np.int16]  # [E] row of the parent, -1 for a root
    box: NDArray[np.float32]  # [E, 4] left, top, width, height in CSS px
    focused: NDArray[np.bool_]  # [E]
    tampered: NDArray[np.bool_]  # [E] acted on earlier in this episode
    colour: tuple[str, ...] = ()  # [E] fill colour of an SVG shape, or colour in an element's own style; else ""
    shape: tuple[str, ...] = ()  # [E] kind of an SVG shape and its corners in px, "triangle 10,40 20,20 30,40"; else ""
    attributes: tuple[str, ...] = ()  # [E] id, placeholder, alt and aria-label of the element, space-separated

    def __post_init__(self) -> None:
        rows = len(self.tag)
        for name in ("colour", "shape", "attributes"):  # optional columns: () stands for a column of ""
            object.__setattr__(self, name, getattr(self, name) or ("",) * rows)
        arrays = ("ref", "parent", "box", "focused", "tampered")
        for name in ("text", "value", "classes", "colour", "shape", "attributes", *arrays):
            if len(getattr(self, name)) != rows:
                raise ValueError(f"Page.{name} has {len(getattr(self, name))} rows, Page.tag has {rows}")
        if self.box.shape != (rows, 4):
            raise ValueError(f"Page.box has shape {self.box.shape}, wanted {(rows, 4)}")
        if not bool(np.all((self.parent >= -1) & (self.parent < np.arange(rows)))):
            raise ValueError("Page.parent has a row that is not before its child, wanted document order, or -1")

    def __len__(self) -> int:
        return len(self.tag)

    def __eq__(self, other: object) -> bool:
        """Whether the other is a page of the same class with equal columns."""
        if not isinstance(other, Page) or type(other) is not type(self):
            return False
        pairs = ((getattr(self, one.name), getattr(other, one.name)) for one in fields(self))
        return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in pairs)

    @property
    def leaf(self) -> NDArray[np.bool_]:
        """[E] True for elements without children: those that can be clicked."""
        leaf = np.ones(len(self.tag), dtype=np.bool_)
        leaf[self.parent[self.parent >= 0]] = False
        return leaf

    def descendants(self, row: int) -> list[int]:
        """The rows of all descendants of an element, in document order."""
        found = {row}
        for later in range(row + 1, len(self.tag)):
            if int(self.parent[later]) in found:
                found.add(later)
        return sorted(found - {row})

    @property
    def typable(self) -> NDArray[np.bool_]:
        """[E] True for text fields."""
        return np.array([tag in TYPABLE_TAGS for tag in self.tag], dtype=np.bool_)
