"""Pages as the miniwob package describes them: the same elements, in the same order, with every one of its fields."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from browser_farm.pages import View
from giirl_core.types import Observation, Page

WINDOW = (780, 437)  # CSS px that a page of the miniwob package has in the Chrome it starts
FLAGS = np.array([1, 2, 4, 8], dtype=np.int32)  # bits of elements.js: focused, tampered, targeted, leaf
WHITE = (1.0, 1.0, 1.0, 1.0)
CHANNEL = re.compile(r"[\d.]+")


@dataclass(frozen=True, slots=True, kw_only=True)
class Elements(Page):
    """A Page whose rows are the package's DOM elements. Refs are its own: text counts down from -1."""

    utterance: str  # read anew at every step, as the page says it
    fields: tuple[tuple[str, str], ...] | None  # of the instruction, where the page itself names them
    id: tuple[str, ...]  # [E] the HTML attribute
    held: tuple[str | bool | None, ...]  # [E] what a field holds, whether a box is checked, None elsewhere
    flags: NDArray[np.int8]  # [E, 4] focused, tampered, targeted, leaf
    background: tuple[str, ...]  # [E] as CSS writes it, "" for lines of text
    foreground: tuple[str, ...]  # [E] likewise


def decode_elements(columns: list[Any]) -> Elements:
    """What elements.js says of a page."""
    (utterance, fields), tag, text, held, id_, classes, numbers, boxes, colours = columns
    table = np.array(numbers, dtype=np.int32).reshape(-1, 5)
    flags = ((table[:, 2:3] & FLAGS) != 0).astype(np.int8)
    return Elements(
        utterance=str(utterance),
        fields=None if fields is None else tuple((str(key), str(value)) for key, value in fields),
        tag=tuple(tag),
        text=tuple(text),
        value=tuple(each if isinstance(each, str) else str(each or "") for each in held),
        held=tuple(held),
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
    )


def elements_of(observation: Observation) -> Elements:
    assert isinstance(observation.page, Elements), "the farm was opened with another view"
    return observation.page


@functools.lru_cache(maxsize=4096)
def rgba(colour: str) -> tuple[float, float, float, float]:
    """A CSS colour as four numbers from 0 to 1; lines of text, which have none, count as white."""
    channels = [float(number) for number in CHANNEL.findall(colour)]
    if not colour.startswith("rgb") or len(channels) not in (3, 4):
        return WHITE
    red, green, blue, alpha = (*channels, 1.0)[:4]
    return red / 255, green / 255, blue / 255, alpha


ELEMENTS = View(
    reader="elements",
    decode=decode_elements,
    emulation=(
        (
            "Emulation.setDeviceMetricsOverride",
            {"width": WINDOW[0], "height": WINDOW[1], "deviceScaleFactor": 1, "mobile": False},
        ),
        ("Emulation.setFocusEmulationEnabled", {"enabled": True}),  # the looks of what has the focus
    ),
)
