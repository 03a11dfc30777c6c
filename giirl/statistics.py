"""Success rates with confidence intervals, and measures of learning curves and rewards."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Z_95 = 1.959963984540054
WINDOW = 100  # last training episodes of a task, whose success a run reports
STREAK = 50  # consecutive training episodes of a task, whose success a study compares with a level


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """Successes among a number of episodes."""

    episodes: int
    successes: int

    @property
    def success(self) -> float | None:
        """The success rate; None without episodes."""
        return self.successes / self.episodes if self.episodes else None

    def __add__(self, other: Score) -> Score:
        return Score(episodes=self.episodes + other.episodes, successes=self.successes + other.successes)

    def row(self, digits: int = 4) -> dict[str, Any]:
        """Episodes, success rate and the ends of its interval, for a JSON result."""
        low, high = self.interval()
        return {
            "episodes": self.episodes,
            "success": self.success,
            "low": round(low, digits),
            "high": round(high, digits),
        }

    def interval(self) -> tuple[float, float]:
        """The 95 % score interval of the success rate (Wilson 1927)."""
        n, p = self.episodes, self.success
        if p is None:
            return 0.0, 1.0
        centre = (p + Z_95**2 / (2 * n)) / (1 + Z_95**2 / n)
        half = Z_95 / (1 + Z_95**2 / n) * math.sqrt(p * (1 - p) / n + Z_95**2 / (4 * n**2))
        return max(0.0, centre - half), min(1.0, centre + half)


def percent(share: float | None) -> str:
    """A share in percent, for a table; "-" for None."""
    return "-" if share is None else f"{100 * share:.1f}"


def missing_pages(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Which tasks have pages that no browser could play, and how many; "" when there is none.

    They are left out of the success rates: an episode that a broken browser or page has ended is no failure.
    """
    missing = [
        f"{count} of {row['episodes'] + count} pages of {task}"
        for task, row in rows.items()
        if (count := row.get("missing", 0))
    ]
    return f"Not played, because the browser or the page broke: {', '.join(missing)}." if missing else ""


def lowest_window(successes: Sequence[bool], window: int) -> float | None:
    """The lowest mean of `window` consecutive outcomes, or of all if there are fewer; None without outcomes."""
    width = min(window, len(successes))
    if width == 0:
        return None
    total = lowest = sum(successes[:width])
    for i in range(width, len(successes)):
        total += successes[i] - successes[i - width]
        lowest = min(lowest, total)
    return lowest / width


Array = NDArray[np.float64]


def goal_sensitivity(right: Array, wrong: Array, weight: Array | None = None) -> float:
    """The fraction of expert pairs (s, a) with r(s,a|g) > r(s,a|g'), given `right` [...] and `wrong` [..., G].

    g is the pair's own goal, g' are G other goals; ties count half. It is a paired AUC: 1/2 for a reward that ignores
    the instruction. Different (s, a) are never compared, so a reward of the form b(s,a) + c(g) gets 1/2 as well.
    `weight` [...] is how often the expert visits each pair, if not equally often.
    """
    own = right[..., None] if wrong.ndim > right.ndim else right
    above = (own > wrong) + 0.5 * (own == wrong)
    mean = above.mean(axis=-1) if wrong.ndim > right.ndim else above
    return float(np.average(mean, weights=weight))
