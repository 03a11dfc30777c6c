"""Line charts as geometry: what a template needs to draw them as SVG, in whatever colours the reader's screen has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

WIDTH, HEIGHT = 320.0, 168.0
LEFT, RIGHT, TOP, BOTTOM = 38.0, 10.0, 8.0, 22.0  # margins
MOST_POINTS = 240  # of a line; more cannot be told apart
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Line:
    """A named sequence of points."""

    name: str
    x: Sequence[float]
    y: Sequence[float]

    def finite(self) -> Line:
        """Without points that cannot be drawn."""
        kept = [(x, y) for x, y in zip(self.x, self.y, strict=True) if math.isfinite(y)]
        return Line(name=self.name, x=[x for x, _ in kept], y=[y for _, y in kept])


@dataclass(frozen=True, slots=True, kw_only=True)
class Level:
    """A value to compare with, as a dashed line across."""

    name: str
    y: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A line in the coordinates of the picture."""

    name: str
    points: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """A picture of WIDTH x HEIGHT."""

    title: str
    says: str  # for a reader who does not see it
    lines: tuple[Drawn, ...]
    levels: tuple[tuple[float, str], ...]  # height and name
    x_ticks: tuple[tuple[float, str], ...]
    y_ticks: tuple[tuple[float, str], ...]


@dataclass(frozen=True, slots=True)
class Axes:
    """Numbers to places in the picture."""

    right: float  # the x of the right edge; the left one is 0
    low: float
    high: float

    def across(self, x: float) -> float:
        return round(LEFT + (WIDTH - LEFT - RIGHT) * x / self.right, 1)

    def up(self, y: float) -> float:
        return round(HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (y - self.low) / (self.high - self.low), 1)


def draw_chart(
    title: str, lines: Sequence[Line], *, levels: Sequence[Level] = (), unit: Literal["", "%"] = ""
) -> Chart:
    """Scale lines and levels into one picture from x = 0; a share, in %, reaches from 0 to 1 at least."""
    seen = [line.finite() for line in lines]
    heights = [y for line in seen for y in line.y] + [level.y for level in levels] + ([0.0, 1.0] if unit else [])
    y_ticks = ticks(min(heights), max(heights))
    right = max((x for line in seen for x in line.x), default=0.0) or 1.0
    axes = Axes(right=right, low=y_ticks[0], high=y_ticks[-1])
    factor = 100 if unit else 1
    return Chart(
        title=title,
        says="; ".join(_in_words(line, factor, unit) for line in seen),
        lines=tuple(Drawn(name=line.name, points=_points(line, axes)) for line in seen),
        levels=tuple((axes.up(level.y), f"{level.name} {_value(factor * level.y, unit)}") for level in levels),
        x_ticks=tuple((axes.across(x), tick_text(x)) for x in ticks(0.0, right) if x <= right),
        y_ticks=tuple((axes.up(y), tick_text(factor * y)) for y in y_ticks),
    )


def ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Round numbers from `low` to `high`: at most `most` intervals, of 1, 2, 2.5 or 5 times a power of ten."""
    if high <= low:
        low, high = low - 0.5 * (abs(low) or 1.0), low + 0.5 * (abs(low) or 1.0)
    raw = (high - low) / most
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(step * power for step in STEPS if step * power >= raw * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [round(number * step, 12) for number in range(first, last + 1)]


def minus(number: str) -> str:
    """A number with a true minus, as wide as a plus."""
    return number.replace("-", "\N{MINUS SIGN}")


def tick_text(value: float) -> str:
    """A number as short as it goes."""
    if abs(value) >= 1000:
        return minus(f"{value / 1000:g}k")
    return minus(f"{value:g}")


def _points(line: Line, axes: Axes) -> str:
    """What an SVG polyline wants, of at most MOST_POINTS points, the first and the last among them."""
    count = len(line.x)
    kept = sorted({round(i * (count - 1) / (MOST_POINTS - 1)) for i in range(MOST_POINTS)}) if count else []
    return " ".join(f"{axes.across(line.x[i])},{axes.up(line.y[i])}" for i in kept)


def _in_words(line: Line, factor: int, unit: str) -> str:
    if not line.y:
        return f"{line.name}: nothing yet"
    return f"{line.name}: from {_value(factor * line.y[0], unit)} to {_value(factor * line.y[-1], unit)}"


def _value(value: float, unit: str) -> str:
    return minus(f"{value:.3g}") + (f" {unit}" if unit else "")
