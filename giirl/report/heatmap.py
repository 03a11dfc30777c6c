"""Heat maps of grid layouts as SVG coordinates. The template adds the colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from giirl.figures import Panel
from giirl.report.overlay import format_reward
from gridcraft.layouts import COLOURS, WALL, Layout

CELL = 20  # side of a cell in SVG units


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One cell of a heat map. `colour` is that of its region, "" outside regions."""

    x: int
    y: int
    wall: bool
    heat: float  # from 0, the lowest value of all maps, to 1, the highest
    colour: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Heat:
    """One heat map."""

    title: str
    description: str  # for screen readers
    width: int
    height: int
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Maps:
    """Heat maps of one layout on a common colour scale; `low` and `high` are its ends."""

    layout: str
    low: str
    high: str
    maps: tuple[Heat, ...]


def draw_heat(layout: Layout, panels: Sequence[Panel]) -> Maps:
    """Draw each panel as a heat map of the layout."""
    values = np.concatenate([panel.values[np.isfinite(panel.values)] for panel in panels])
    low, high = float(values.min()), float(values.max())
    return Maps(
        layout=layout.name,
        low=format_reward(low),
        high=format_reward(high),
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
        f"{colour} {format_reward(float(panel.values[layout.cells == region].mean()))}"
        for region, colour in enumerate(COLOURS, start=1)
        if (layout.cells == region).any()
    ]
    description = f"{panel.title} Mean reward by region: {', '.join(means)}."
    return Heat(
        title=panel.title, description=description, width=CELL * columns, height=CELL * rows, cells=tuple(cells)
    )
