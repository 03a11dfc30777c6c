"""Counts with the uncertainty that belongs to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

Z_95 = 1.959963984540054
WINDOW = 100  # training episodes in a row, of which the success is told


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """How often a policy succeeded."""

    episodes: int
    successes: int

    @property
    def success(self) -> float:
        return self.successes / self.episodes

    def __add__(self, other: Score) -> Score:
        return Score(episodes=self.episodes + other.episodes, successes=self.successes + other.successes)

    def interval(self) -> tuple[float, float]:
        """The 95 % score interval of a proportion (Wilson 1927)."""
        n, p = self.episodes, self.success
        centre = (p + Z_95**2 / (2 * n)) / (1 + Z_95**2 / n)
        half = Z_95 / (1 + Z_95**2 / n) * math.sqrt(p * (1 - p) / n + Z_95**2 / (4 * n**2))
        return max(0.0, centre - half), min(1.0, centre + half)


def lowest_window(successes: Sequence[bool], window: int) -> float | None:
    """The lowest mean over `window` outcomes in a row, or over all of them where there are fewer; None of none."""
    width = min(window, len(successes))
    if width == 0:
        return None
    total = lowest = sum(successes[:width])
    for i in range(width, len(successes)):
        total += successes[i] - successes[i - width]
        lowest = min(lowest, total)
    return lowest / width
