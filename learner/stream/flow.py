"""Flow control: bounds the number of outstanding episodes, so that few become stale before they are trained on.

An episode is outstanding while it is played, scored, sent or queued. A new episode is trained on after the outstanding
ones, so its policy is then about outstanding / batch versions old (Little's law), and more for a long episode. The
bound therefore adapts to the observed lag: additive increase, multiplicative decrease.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

INCREASE = 0.05  # fraction of a batch added to the bound after a batch whose episodes were all below `max_lag`
DECREASE = 0.9  # factor on the bound after a batch with an episode at `max_lag`, or after dropped stale episodes
INITIAL_BATCHES = 2.0  # initial bound, in batches
MIN_BATCHES = 0.25  # smallest bound, in batches


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestLimits:
    """Limits on outstanding episodes and on the age of their policy. ValueError if they admit no episode."""

    credits: int = 4  # most outstanding episodes of one actor
    batch: int = 0  # episodes per learner step; 0 turns flow control off, so that each actor has all its credits
    max_lag: int = 4  # policy versions; older episodes are dropped on arrival and in the queue; 0 is lock-step
    max_bytes: int = 256 << 20  # encoded bytes in the queue; while it holds more, no actor has credits

    def __post_init__(self) -> None:
        if self.credits < 1 or self.max_lag < 0 or self.max_bytes < 1 or self.batch < 0:
            raise ValueError(f"{self} admits no episode: wanted credits and max_bytes >= 1, max_lag and batch >= 0")


class FlowControl:
    """The bound on the outstanding episodes of all actors together. Not thread-safe."""

    def __init__(self, batch: int, max_lag: int, *, stale: int = 0) -> None:
        """`batch` is the number of episodes per learner step; episodes more than `max_lag` versions old are dropped.

        `stale` is the number dropped so far. There is no bound if `batch` is 0, and in lock-step (`max_lag` 0).
        """
        self._batch, self._max_lag, self._stale = batch, max_lag, stale
        self.outstanding = min(INITIAL_BATCHES, max_lag) * batch if batch and max_lag else float("inf")

    def observe(self, lags: Sequence[int], stale: int) -> None:
        """Adapt the bound after one batch. `lags` are those of its episodes, in versions.

        `stale` is the number of stale episodes dropped so far.
        """
        if self.outstanding == float("inf"):
            return
        if stale > self._stale or max(lags, default=0) >= self._max_lag:
            self.outstanding = max(self.outstanding * DECREASE, MIN_BATCHES * self._batch)
        else:
            self.outstanding = min(self.outstanding + INCREASE * self._batch, float(self._max_lag * self._batch))
        self._stale = stale

    def windows(self, actors: Sequence[str], credits: int) -> dict[str, int]:
        """The number of outstanding episodes that each actor may have, at most `credits`.

        Shares are equal; the remainder goes to the first actors by name.
        """
        if self.outstanding == float("inf"):
            return dict.fromkeys(actors, credits)
        base, extra = divmod(max(1, int(self.outstanding)), max(1, len(actors)))
        return {name: min(base + (index < extra), credits) for index, name in enumerate(sorted(actors))}
