"""The view of the miniwob package: the same DOM elements, in the same order, with all of its fields."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from browser_farm.pages import View, decode_page
from giirl_core.types import Observation, Page

WINDOW = (780, 437)  # CSS px: size of the viewport in the miniwob package's own Chrome
FLAGS = np.array([1, 2, 4, 8], dtype=np.int32)  # bits of elements.js: focused, tampered, targeted, leaf
WHITE = (1.0, 1.0, 1.0, 1.0)
CHANNEL = re.compile(r"[\d.]+")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Elements(Page):
    """A Page whose rows are the package's DOM elements, with its refs: negative for lines of text."""

    utterance: str  # the instruction, which a page may change between steps
    fields: tuple[tuple[str, str], ...] | None  # of the instruction; None unless the page itself names them
    id: tuple[str, ...]  # [E] the HTML attribute
    raw_value: tuple[str | bool | None, ...]  # [E] value of a field, whether a box is checked, None elsewhere
    flags: NDArray[np.int8]  # [E, 4] focused, tampered, targeted, leaf
    background: tuple[str, ...]  # [E] CSS colour, "" for lines of text
    foreground: tuple[str, ...]  # [E] likewise
    agent_page: Page | None = None  # as the agents of this project read it, with refs of this table; None if not read


def decode_elements(columns: list[Any]) -> Elements:
    """An Elements page from the columns that elements.js returns."""
    (utterance, fields), tag, text, raw_value, id_, classes, numbers, boxes, colours, *rows = columns
    table = np.array(numbers, dtype=np.int32).reshape(-1, 5)
    flags = ((table[:, 2:3] & FLAGS) != 0).astype(np.int8)
    return Elements(
        utterance=str(utterance),
        fields=None if fields is None else tuple((str(key), str(value)) for key, value in fields),
        tag=tuple(tag),
        text=tuple(text),
        value=tuple(value if isinstance(value, str) else str(value or "") for value in raw_value),
        raw_value=tuple(raw_value),
        id=tuple(id_),
        classes=tuple(classes),
        ref=table[:, 0].copy(),
        parent=table[:, 1].astype(np.int16),
        box=np.array(boxes, dtype=np.float32).reshape(-1, 4),
        focused=flags[:, 0] != 0,
        tampered=flags[:, 1] != 0,
        flags=flags,
        background=tuple(colours[index] for index in table[:, 3].tolist()),
        foreground=tuple(colours[index] for index in table[:, 4].tolist()),
        agent_page=decode_page(rows[0]) if rows else None,
    )


def elements_of(observation: Observation) -> Elements:
    """The page of an observation from a farm that was opened with the ELEMENTS view."""
    assert isinstance(observation.page, Elements), "the farm was opened with another view"
    return observation.page


@functools.lru_cache(maxsize=4096)
def rgba(colour: str) -> tuple[float, float, float, float]:
    """A CSS colour as RGBA from 0 to 1. White for "" (lines of text) and for notations other than rgb()."""
    channels = [float(number) for number in CHANNEL.findall(colour)]
    if not colour.startswith("rgb") or len(channels) not in (3, 4):
        return WHITE
    red, green, blue, alpha = (*channels, 1.0)[:4]
    return red / 255, green / 255, blue / 255, alpha


AGENT_ELEMENTS = "elementsAndRows"  # the reader of a view whose pages have their `agent_page`
ELEMENTS = View(
    reader="elements",
    decode=decode_elements,
    emulation=(
        (
            "Emulation.setDeviceMetricsOverride",
            {"width": WINDOW[0], "height": WINDOW[1], "deviceScaleFactor": 1, "mobile": False},
        ),
        ("Emulation.setFocusEmulationEnabled", {"enabled": True}),  # draws the style of the focused element
    ),
)
