"""Flow control: how many episodes may be outstanding, so that actors play none that would be dropped as stale.

Outstanding are the episodes that are being played, scored, sent or queued. An episode that starts now is trained on
after those in front of it, so its policy is about outstanding / batch versions old by then (Little's law), and older
where it takes longer than the others. The bound on outstanding episodes therefore follows the lag that is observed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

GROWTH = 0.05  # of the batch, added for every batch whose episodes were all recent enough
SHRINK = 0.9  # factor for every batch with an episode at the limit of lag, or with stale ones dropped
START = 2.0  # batches outstanding at first
MIN_SHARE = 0.25  # of a batch that may always be outstanding


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestLimits:
    """How far actors may run ahead of the learner, and how old the policy of an episode may be."""

    credits: int = 4  # outstanding episodes of one actor, at most
    batch: int = 0  # episodes taken at a time, for flow control; without it each actor has all its credits
    max_lag: int = 4  # policy versions; older episodes are dropped on arrival and in the queue; 0 means lock-step
    max_bytes: int = 256 << 20  # encoded bytes in the queue; above this no actor has credits

    def __post_init__(self) -> None:
        if self.credits < 1 or self.max_lag < 0 or self.max_bytes < 1 or self.batch < 0:
            raise ValueError(f"{self} admits no episode: wanted credits and max_bytes >= 1, max_lag and batch >= 0")


class FlowControl:
    """The bound on outstanding episodes of all actors together. Not thread-safe."""

    def __init__(self, batch: int, max_lag: int) -> None:
        """`batch` episodes are taken at a time; those more than `max_lag` versions old are dropped.

        Without a batch, and in lock-step (`max_lag` 0), there is no bound.
        """
        self._batch, self._max_lag, self._stale = batch, max_lag, 0
        self.outstanding = min(START, max_lag) * batch if batch and max_lag else float("inf")

    def observe(self, lags: Sequence[int], stale: int) -> None:
        """Adapt to one batch: the lag of each of its episodes, versions, and the stale ones dropped so far."""
        if self.outstanding == float("inf"):
            return
        if stale > self._stale or max(lags, default=0) >= self._max_lag:
            self.outstanding = max(self.outstanding * SHRINK, MIN_SHARE * self._batch)
        else:
            self.outstanding = min(self.outstanding + GROWTH * self._batch, float(self._max_lag * self._batch))
        self._stale = stale

    def windows(self, actors: Sequence[str], most: int) -> dict[str, int]:
        """Outstanding episodes that each actor may have: equal shares, the remainder to the first, `most` at most."""
        if self.outstanding == float("inf"):
            return dict.fromkeys(actors, most)
        base, extra = divmod(max(1, int(self.outstanding)), max(1, len(actors)))
        return {name: min(base + (place < extra), most) for place, name in enumerate(sorted(actors))}
