"""Pages and dialogs as values: what site.js reads, in the units of a MiniWoB page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from browser_farm.pages import FOCUSED, TAMPERED
from giirl_core.types import Page

WIDTH = 160.0  # the viewport's width in the units of Page.box, as MiniWoB's pages are 160 px wide
LINE = 20.0  # height of a row of a dialog, in these units
OK, CANCEL = "OK", "Cancel"


@dataclass(frozen=True, slots=True)
class Read:
    """A page that was read, and the number of elements that were left out of it."""

    page: Page
    left_out: int


def decode(columns: list[Any], scale: float) -> Read:
    """The page of the columns of site.js. ValueError or TypeError if they are malformed.

    `scale` is the number of units of a CSS px.
    """
    tag, text, value, classes, attributes, numbers, boxes, left_out = columns
    table = np.array(numbers, dtype=np.int32).reshape(-1, 3)
    flags = table[:, 2]
    page = Page(
        tag=tuple(tag),
        text=tuple(text),
        value=tuple(value),
        classes=tuple(classes),
        attributes=tuple(attributes),
        ref=table[:, 0].copy(),
        parent=table[:, 1].astype(np.int16),
        box=np.array(boxes, dtype=np.float32).reshape(-1, 4) * np.float32(scale),
        focused=(flags & FOCUSED) != 0,
        tampered=(flags & TAMPERED) != 0,
    )
    return Read(page, int(left_out))


@dataclass(slots=True)
class Dialog:
    """An open alert, confirm or prompt. The page stands still until it is answered, so it is all that can be seen."""

    kind: str  # as in Page.javascriptDialogOpening
    message: str
    text: str  # of the field of a prompt
    typed: bool = False
    first_ref: int = 0  # of its rows; 0 until the dialog was seen

    @property
    def buttons(self) -> tuple[str, ...]:
        """The texts of its buttons."""
        return (OK,) if self.kind == "alert" else (OK, CANCEL)

    def rows(self) -> list[tuple[str, str, str]]:
        """Tag, text and value of each row: the dialog, its message, the field of a prompt, the buttons."""
        field = [("input_text", self.message, self.text)] if self.kind == "prompt" else []
        message = [("t", self.message, "")] if self.message else []
        return [("dialog", "", ""), *message, *field, *(("button", button, "") for button in self.buttons)]

    def page(self, first_ref: int) -> Page:
        """The dialog as a page; its rows have the refs from `first_ref` on."""
        self.first_ref = first_ref
        rows, count = self.rows(), len(self.rows())
        top = LINE * np.arange(count, dtype=np.float32)
        box = np.stack([np.zeros_like(top), top, np.full_like(top, WIDTH), np.full_like(top, LINE)], axis=1)
        box[0] = (0.0, 0.0, WIDTH, LINE * count)
        return Page(
            tag=tuple(row[0] for row in rows),
            text=tuple(row[1] for row in rows),
            value=tuple(row[2] for row in rows),
            classes=("",) * count,
            ref=np.arange(first_ref, first_ref + count, dtype=np.int32),
            parent=np.array([-1] + [0] * (count - 1), dtype=np.int16),
            box=box,
            focused=np.zeros(count, dtype=np.bool_),
            tampered=np.array([row[0] == "input_text" and self.typed for row in rows], dtype=np.bool_),
        )

    def row_of(self, ref: int) -> tuple[str, str, str]:
        """The row with a ref; empty texts if it has none."""
        index = ref - self.first_ref
        return self.rows()[index] if 0 <= index < len(self.rows()) else ("", "", "")
