"""Figures as PNG: maps of a learned reward, and learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from giirl_core.files import atomic_write
from gridcraft.layouts import COLOURS, Layout

INKS = ("#404040", "#ffffff", "#d7301f", "#31a354", "#3182bd", "#fec44f")  # wall, white, then COLOURS
DOTS_PER_INCH = 120
INCHES = 3.2  # width of a panel

assert len(INKS) == len(COLOURS) + 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panel:
    """Values on the cells of a layout."""

    title: str
    values: NDArray[np.float64]  # [H, W], nan for walls


def draw_maps(path: Path, layout: Layout, panels: Sequence[Panel]) -> None:
    """Draw the layout in its colours, and next to it each panel as a heat map, all on one scale."""
    figure = Figure(figsize=(INCHES * (len(panels) + 1), INCHES + 0.3), layout="constrained")
    axes = figure.subplots(1, len(panels) + 1, squeeze=False)[0]
    paint = ListedColormap(INKS)
    axes[0].imshow(layout.cells, cmap=paint, norm=BoundaryNorm(np.arange(-1.5, len(COLOURS) + 1), paint.N))
    axes[0].set_title(f"the map: {layout.name}", fontsize=9)
    values = np.concatenate([panel.values[np.isfinite(panel.values)] for panel in panels])
    image = None
    for axis, panel in zip(axes[1:], panels, strict=True):
        axis.set_facecolor(INKS[0])
        image = axis.imshow(panel.values, cmap="viridis", vmin=values.min(), vmax=values.max())
        axis.set_title(panel.title, fontsize=9)
        _outline(axis, layout)
    for axis in axes:
        axis.set_xticks([])
        axis.set_yticks([])
    if image is not None:
        figure.colorbar(image, ax=list(axes[1:]), label="learned reward", shrink=0.8)
    _save(figure, path)


def draw_successes(path: Path, runs: Sequence[Mapping[str, Any]]) -> None:
    """Draw the success of the exploring policy against environment steps, one panel per task.

    Each variant has a line, the mean over its seeds, and a band from the worst seed to the best. A run that took fewer
    steps keeps its last value. `runs` are records of a study, with "variant", "seed", "tasks" and "curve".
    """
    tasks = list(runs[0]["tasks"])
    figure = Figure(figsize=(INCHES * len(tasks), 2.6), layout="constrained")
    axes = figure.subplots(1, len(tasks), squeeze=False, sharey=True)[0]
    for axis, task in zip(axes, tasks, strict=True):
        for variant in dict.fromkeys(run["variant"] for run in runs):
            curves = [run["curve"] for run in runs if run["variant"] == variant and task in run["tasks"]]
            if not curves:
                continue
            ends = min(curve[0]["env_steps"] for curve in curves), max(curve[-1]["env_steps"] for curve in curves)
            steps = np.geomspace(*ends, 200)
            lines = np.stack([_success_at(steps, curve, task) for curve in curves])
            (line,) = axis.plot(steps, lines.mean(axis=0), label=variant)
            axis.fill_between(steps, lines.min(axis=0), lines.max(axis=0), color=line.get_color(), alpha=0.2)
        axis.set_title(task, fontsize=9)
        axis.set_xlabel("environment steps", fontsize=8)
        axis.set_xscale("log")
        axis.set_ylim(-0.02, 1.02)
        axis.tick_params(labelsize=7)
    axes[0].set_ylabel("success", fontsize=8)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    _save(figure, path)


def _success_at(steps: NDArray[np.float64], curve: Sequence[Mapping[str, Any]], task: str) -> NDArray[np.float64]:
    """Linear interpolation of a curve at `steps`; nan before its first value, its last value after its end."""
    success = [np.nan if point["success"].get(task) is None else point["success"][task] for point in curve]
    line: NDArray[np.float64] = np.interp(steps, [point["env_steps"] for point in curve], success, left=np.nan)
    return line


def draw_returns(path: Path, env_steps: NDArray[np.int64], returns: Mapping[str, NDArray[np.float64]]) -> None:
    """Draw return against steps [P] for each goal, from [seeds, P]: the mean, with a band from worst to best seed."""
    columns = min(len(returns), 3)
    rows = -(-len(returns) // columns)
    figure = Figure(figsize=(INCHES * columns, 2.4 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axis, (goal, curves) in zip(axes.flat, returns.items(), strict=False):
        axis.fill_between(env_steps, curves.min(axis=0), curves.max(axis=0), alpha=0.3, linewidth=0)
        axis.plot(env_steps, curves.mean(axis=0))
        axis.axhline(1.0, linewidth=0.6, color="#404040")
        axis.set_title(goal, fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("environment steps", fontsize=8)
        axis.locator_params(axis="x", nbins=4)
    for axis in axes[:, 0]:
        axis.set_ylabel("return over optimal", fontsize=8)
    for axis in axes.flat[len(returns) :]:
        axis.set_visible(False)
    _save(figure, path)


def _outline(axis: Axes, layout: Layout) -> None:
    """Draw the outlines of the coloured regions."""
    for number in range(1, len(COLOURS) + 1):
        for row, column in np.argwhere(layout.cells == number):
            corner = (float(column) - 0.42, float(row) - 0.42)
            axis.add_patch(Rectangle(corner, 0.84, 0.84, fill=False, edgecolor=INKS[number + 1], linewidth=1.2))


def _save(figure: Figure, path: Path) -> None:
    """Write the PNG, without a window system and without a date in the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure)
    with atomic_write(path) as file:
        figure.savefig(file, format="png", dpi=DOTS_PER_INCH, metadata={"Software": None})
