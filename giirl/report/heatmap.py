"""A grid's numbers as a map of cells, in whatever colours the reader's screen has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from giirl.figures import Panel
from giirl.report.overlay import number
from gridcraft.layouts import COLOURS, WALL, Layout

CELL = 20  # the side of a cell in the picture


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One cell of a map; `colour` is the region it belongs to, "" for none."""

    x: int
    y: int
    wall: bool
    heat: float  # from 0, the lowest number of all maps, to 1, the highest
    colour: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Heat:
    """One map."""

    title: str
    says: str  # for a reader who does not see it
    width: int
    height: int
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Maps:
    """Maps on one scale."""

    layout: str
    low: str
    high: str
    maps: tuple[Heat, ...]


def draw_heat(layout: Layout, panels: Sequence[Panel]) -> Maps:
    """Each panel as a map of the layout."""
    every = np.concatenate([panel.values[np.isfinite(panel.values)] for panel in panels])
    low, high = float(every.min()), float(every.max())
    return Maps(
        layout=layout.name,
        low=number(low),
        high=number(high),
        maps=tuple(_heat(layout, panel, low, high) for panel in panels),
    )


def _heat(layout: Layout, panel: Panel, low: float, high: float) -> Heat:
    rows, columns = layout.cells.shape
    cells = []
    for row, column in np.ndindex(rows, columns):
        region, value = int(layout.cells[row, column]), float(panel.values[row, column])
        heat = (value - low) / (high - low) if np.isfinite(value) and high > low else 0.0
        colour = COLOURS[region - 1] if region > 0 else ""
        cells.append(Cell(x=CELL * column, y=CELL * row, wall=region == WALL, heat=round(heat, 3), colour=colour))
    means = [
        f"{colour} {number(float(panel.values[layout.cells == region].mean()))}"
        for region, colour in enumerate(COLOURS, start=1)
        if (layout.cells == region).any()
    ]
    says = f"{panel.title} Mean reward by region: {', '.join(means)}."
    return Heat(title=panel.title, says=says, width=CELL * columns, height=CELL * rows, cells=tuple(cells))
