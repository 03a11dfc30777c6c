"""Wilson intervals and windows, compared with published values and with enumeration."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl.statistics import Z_95, Score, lowest_window


@pytest.mark.parametrize(
    ("successes", "episodes", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),  # Newcombe 1998, table I
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_intervals_match_the_table_of_newcombe(successes: int, episodes: int, low: float, high: float) -> None:
    assert Score(episodes=episodes, successes=successes).interval() == pytest.approx((low, high), abs=5e-5)


@given(st.integers(1, 3000).flatmap(lambda n: st.tuples(st.just(n), st.integers(0, n))))
def test_the_score_test_just_rejects_at_the_ends_of_the_interval(counts: tuple[int, int]) -> None:
    n, k = counts
    low, high = Score(episodes=n, successes=k).interval()
    assert 0 <= low <= k / n + 1e-12
    assert k / n - 1e-12 <= high <= 1
    for p in (low, high):
        if 1e-9 < p < 1 - 1e-9:
            assert abs(k / n - p) / math.sqrt(p * (1 - p) / n) == pytest.approx(Z_95, rel=1e-6)


@given(st.lists(st.booleans(), min_size=1, max_size=30), st.integers(1, 12))
def test_the_lowest_window_matches_enumeration(successes: list[bool], window: int) -> None:
    width = min(window, len(successes))
    means = [sum(successes[i : i + width]) / width for i in range(len(successes) - width + 1)]
    assert lowest_window(successes, window) == pytest.approx(min(means))


def test_the_lowest_window_of_no_outcomes_is_none() -> None:
    assert lowest_window([], 10) is None
