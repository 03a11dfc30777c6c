"""Charts have round ticks, lines within the axes and a description for screen readers."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl.report.charts import (
    BOTTOM,
    HEIGHT,
    LEFT,
    MAX_POINTS,
    RIGHT,
    TOP,
    WIDTH,
    Level,
    Line,
    draw_chart,
    tick_text,
    ticks,
)

NUMBER = st.floats(-1e6, 1e6, allow_subnormal=False).map(lambda x: round(x, 3))


def coordinates(points: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in (pair.split(",") for pair in points.split())]


@given(NUMBER, NUMBER)
def test_ticks_cover_the_values_in_equal_steps(one: float, other: float) -> None:
    low, high = min(one, other), max(one, other)
    found = ticks(low, high)
    assert found[0] <= low + 1e-6
    assert found[-1] >= high - 1e-6
    assert 2 <= len(found) <= 8
    steps = [b - a for a, b in pairwise(found)]
    assert max(steps) == pytest.approx(min(steps))


@given(st.lists(st.tuples(NUMBER.map(abs), NUMBER), min_size=1, max_size=600))
def test_all_points_lie_within_the_axes_and_the_ends_are_kept(points: list[tuple[float, float]]) -> None:
    xs, ys = sorted(x for x, _ in points), [y for _, y in points]
    drawn = coordinates(draw_chart("t", [Line(name="n", x=xs, y=ys)]).lines[0].points)
    assert len(drawn) <= MAX_POINTS
    assert all(LEFT <= x <= WIDTH - RIGHT and TOP <= y <= HEIGHT - BOTTOM for x, y in drawn)
    assert drawn[-1][0] == (WIDTH - RIGHT if xs[-1] else LEFT)


def test_a_percentage_is_drawn_from_0_to_100_for_any_values() -> None:
    chart = draw_chart("t", [Line(name="n", x=[0, 10], y=[0.4, 0.5])], levels=[Level(name="random", y=0.25)], unit="%")
    assert [text for _, text in chart.y_ticks] == ["0", "20", "40", "60", "80", "100"]
    assert chart.levels == ((TOP + 0.75 * (HEIGHT - TOP - BOTTOM), "random 25 %"),)
    assert chart.description == "n: from 40 % to 50 %"


def test_values_that_are_not_finite_are_left_out_and_an_empty_line_is_described() -> None:
    none = Line(name="none", x=[1, 2], y=[math.nan, math.inf])
    chart = draw_chart("t", [Line(name="some", x=[1, 2, 3], y=[1.0, math.nan, 2.0]), none])
    assert [len(coordinates(line.points)) for line in chart.lines] == [2, 0]
    assert chart.description == "some: from 1 to 2; none: no data"


@pytest.mark.parametrize(("value", "text"), [(0, "0"), (2500, "2.5k"), (-12.5, "\N{MINUS SIGN}12.5"), (0.25, "0.25")])
def test_tick_labels_are_short_and_use_the_unicode_minus(value: float, text: str) -> None:
    assert tick_text(value) == text
