"""Flow control: how many episodes may be outstanding, so that actors play none that would be dropped as stale.

Outstanding are the episodes that are being played, scored, sent or queued. An episode that starts now is trained on
after those in front of it, so its policy is about outstanding / batch versions old by then (Little's law), and older
where it takes longer than the others. The bound on outstanding episodes therefore follows the lag that is observed.
"""

from __future__ import annotations

from collections.abc import Sequence

GROWTH = 0.05  # of the batch, added for every batch whose episodes were all recent enough
SHRINK = 0.9  # factor for every batch with an episode at the limit of lag, or with stale ones dropped
START = 2.0  # batches outstanding at first
MIN_SHARE = 0.25  # of a batch that may always be outstanding


class FlowControl:
    """The bound on outstanding episodes of all actors together. Not thread-safe."""

    def __init__(self, batch: int, max_lag: int) -> None:
        """`batch` episodes are taken at a time; those more than `max_lag` versions old are dropped."""
        self._batch, self._max_lag = batch, max_lag
        self.outstanding = min(START, max(max_lag, 1)) * batch

    def observe(self, lags: Sequence[int], dropped: int) -> None:
        """Adapt to one batch: the lag of each of its episodes, versions, and how many were dropped as stale since."""
        if dropped or max(lags, default=0) >= self._max_lag:
            self.outstanding = max(self.outstanding * SHRINK, MIN_SHARE * self._batch)
        else:
            self.outstanding = min(self.outstanding + GROWTH * self._batch, float(self._max_lag * self._batch))

    def share(self, place: int, actors: int) -> int:
        """Outstanding episodes of the actor at `place` among so many: equal shares, the remainder to the first."""
        base, extra = divmod(max(1, int(self.outstanding)), max(1, actors))
        return base + (place < extra)
