"""Line charts as SVG coordinates. The template adds the colours, which follow the reader's light or dark theme."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

WIDTH, HEIGHT = 320.0, 168.0
LEFT, RIGHT, TOP, BOTTOM = 38.0, 10.0, 8.0, 22.0  # margins
MAX_POINTS = 240  # per line; more points cannot be distinguished at this width
TICK_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A named series of points (x, y)."""

    name: str
    x: Sequence[float]
    y: Sequence[float]

    def finite(self) -> Line:
        """The line without points whose y is nan or infinite."""
        kept = [(x, y) for x, y in zip(self.x, self.y, strict=True) if math.isfinite(y)]
        return Line(name=self.name, x=[x for x, _ in kept], y=[y for _, y in kept])


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A reference value, drawn as a dashed horizontal line."""

    name: str
    y: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Polyline:
    """A line in SVG coordinates."""

    name: str
    points: str  # the `points` attribute of an SVG polyline


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """A chart of WIDTH x HEIGHT SVG units."""

    title: str
    description: str  # for screen readers
    lines: tuple[Polyline, ...]
    levels: tuple[tuple[float, str], ...]  # y coordinate and label
    x_ticks: tuple[tuple[float, str], ...]  # x coordinate and label
    y_ticks: tuple[tuple[float, str], ...]  # y coordinate and label


@dataclass(frozen=True, slots=True)
class Axes:
    """Maps data values to SVG coordinates."""

    right: float  # the x value at the right edge; the left edge is 0
    low: float  # the y value at the bottom
    high: float  # the y value at the top

    def to_x(self, x: float) -> float:
        """The SVG x coordinate of a value."""
        return round(LEFT + (WIDTH - LEFT - RIGHT) * x / self.right, 1)

    def to_y(self, y: float) -> float:
        """The SVG y coordinate of a value."""
        return round(HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (y - self.low) / (self.high - self.low), 1)


def draw_chart(
    title: str, lines: Sequence[Line], *, levels: Sequence[Level] = (), unit: Literal["", "%"] = ""
) -> Chart:
    """Draw lines and levels on common axes, with x from 0.

    With unit "%" the values are fractions: the y axis includes 0 and 1 and is labelled in percent.
    """
    finite = [line.finite() for line in lines]
    values = [y for line in finite for y in line.y] + [level.y for level in levels] + ([0.0, 1.0] if unit else [])
    y_ticks = ticks(min(values), max(values))
    right = max((x for line in finite for x in line.x), default=0.0) or 1.0
    axes = Axes(right=right, low=y_ticks[0], high=y_ticks[-1])
    factor = 100 if unit else 1
    return Chart(
        title=title,
        description="; ".join(_describe(line, factor, unit) for line in finite),
        lines=tuple(Polyline(name=line.name, points=_points(line, axes)) for line in finite),
        levels=tuple((axes.to_y(level.y), f"{level.name} {_value(factor * level.y, unit)}") for level in levels),
        x_ticks=tuple((axes.to_x(x), tick_text(x)) for x in ticks(0.0, right) if x <= right),
        y_ticks=tuple((axes.to_y(y), tick_text(factor * y)) for y in y_ticks),
    )


def ticks(low: float, high: float, max_intervals: int = 5) -> list[float]:
    """Round numbers that cover `low` to `high`, with a step of 1, 2, 2.5 or 5 times a power of ten.

    The step is at least the range divided by `max_intervals`.
    """
    if high <= low:
        low, high = low - 0.5 * (abs(low) or 1.0), low + 0.5 * (abs(low) or 1.0)
    raw = (high - low) / max_intervals
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(step * power for step in TICK_STEPS if step * power >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(number * step, 12) for number in range(first, last + 1)]


def minus(number: str) -> str:
    """Replace hyphens by the Unicode minus sign, which is as wide as a plus."""
    return number.replace("-", "\N{MINUS SIGN}")


def tick_text(value: float) -> str:
    """The shortest form of a number; thousands are written with k."""
    if abs(value) >= 1000:
        return minus(f"{value / 1000:g}k")
    return minus(f"{value:g}")


def _points(line: Line, axes: Axes) -> str:
    """The `points` attribute of an SVG polyline: at most MAX_POINTS points, including the first and the last."""
    count = len(line.x)
    kept = sorted({round(i * (count - 1) / (MAX_POINTS - 1)) for i in range(MAX_POINTS)}) if count else []
    return " ".join(f"{axes.to_x(line.x[i])},{axes.to_y(line.y[i])}" for i in kept)


def _describe(line: Line, factor: int, unit: str) -> str:
    if not line.y:
        return f"{line.name}: no data"
    return f"{line.name}: from {_value(factor * line.y[0], unit)} to {_value(factor * line.y[-1], unit)}"


def _value(value: float, unit: str) -> str:
    return minus(f"{value:.3g}") + (f" {unit}" if unit else "")
