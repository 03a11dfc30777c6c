"""Charts: round ticks, lines that stay in the picture, and words for who sees none."""

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
    MOST_POINTS,
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


def places(points: str) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in (pair.split(",") for pair in points.split())]


@given(NUMBER, NUMBER)
def test_ticks_reach_around_the_numbers_in_at_most_six_even_steps(one: float, other: float) -> None:
    low, high = min(one, other), max(one, other)
    found = ticks(low, high)
    assert found[0] <= low + 1e-6
    assert found[-1] >= high - 1e-6
    assert 2 <= len(found) <= 8
    steps = [b - a for a, b in pairwise(found)]
    assert max(steps) == pytest.approx(min(steps))


@given(st.lists(st.tuples(NUMBER.map(abs), NUMBER), min_size=1, max_size=600))
def test_no_point_leaves_the_picture_and_the_ends_are_kept(points: list[tuple[float, float]]) -> None:
    xs, ys = sorted(x for x, _ in points), [y for _, y in points]
    drawn = places(draw_chart("t", [Line(name="n", x=xs, y=ys)]).lines[0].points)
    assert len(drawn) <= MOST_POINTS
    assert all(LEFT <= x <= WIDTH - RIGHT and TOP <= y <= HEIGHT - BOTTOM for x, y in drawn)
    assert drawn[-1][0] == (WIDTH - RIGHT if xs[-1] else LEFT)


def test_a_share_is_drawn_from_0_to_100_whatever_its_values() -> None:
    chart = draw_chart("t", [Line(name="n", x=[0, 10], y=[0.4, 0.5])], levels=[Level(name="chance", y=0.25)], unit="%")
    assert [text for _, text in chart.y_ticks] == ["0", "20", "40", "60", "80", "100"]
    assert chart.levels == ((TOP + 0.75 * (HEIGHT - TOP - BOTTOM), "chance 25 %"),)
    assert chart.says == "n: from 40 % to 50 %"


def test_what_is_not_finite_is_left_out_and_a_line_without_points_says_so() -> None:
    none = Line(name="none", x=[1, 2], y=[math.nan, math.inf])
    chart = draw_chart("t", [Line(name="some", x=[1, 2, 3], y=[1.0, math.nan, 2.0]), none])
    assert [len(places(line.points)) for line in chart.lines] == [2, 0]
    assert chart.says == "some: from 1 to 2; none: nothing yet"


@pytest.mark.parametrize(("value", "text"), [(0, "0"), (2500, "2.5k"), (-12.5, "\N{MINUS SIGN}12.5"), (0.25, "0.25")])
def test_ticks_are_written_short_with_a_true_minus(value: float, text: str) -> None:
    assert tick_text(value) == text
