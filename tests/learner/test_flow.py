"""Flow control on a simulated clock: few episodes grow stale, whatever the number and the speed of actors."""

from __future__ import annotations

import heapq
from collections import deque
from itertools import count

import numpy as np
import pytest

from learner.stream.flow import FlowControl, IngestLimits

BATCH, MAX_LAG, TABS = 32, 4, 8


class Simulation:
    """Actors of eight tabs, whose episodes take 1 to 10 steps, and a learner that takes one batch after another."""

    def __init__(self, actors: int, step_s: float, update_s: float, *, credits_: int = 256) -> None:
        self.flow = FlowControl(BATCH, MAX_LAG)
        self._names = [f"actor-{index:04}" for index in range(actors)]
        self._step_s, self._update_s, self._credits = step_s, update_s, credits_
        self._rng, self._order = np.random.default_rng(0), count()
        self._playing = dict.fromkeys(self._names, 0)
        self._queued = dict.fromkeys(self._names, 0)
        self._events: list[tuple[float, int, str, int]] = []  # end of an episode: time, order, actor, version
        self._queue: deque[tuple[str, int]] = deque()
        self.version = self.taken = self.stale = 0
        self.lags: list[int] = []

    def run(self, batches: int) -> None:
        now_s, free_s = 0.0, 0.0  # when the learner is done with its batch
        self._start(now_s)
        pulled: list[int] = []
        while self.version < batches:
            if now_s >= free_s:
                while self._queue and len(pulled) < BATCH:
                    actor, version = self._queue.popleft()
                    self._queued[actor] -= 1
                    if self.version - version > MAX_LAG:
                        self.stale += 1
                    else:
                        pulled.append(version)
                if len(pulled) == BATCH:
                    lags = [self.version - version for version in pulled]
                    self.flow.observe(lags, self.stale)
                    self.taken, self.lags, pulled = self.taken + BATCH, self.lags + lags, []
                    self.version, free_s = self.version + 1, now_s + self._update_s
                self._start(now_s)
            if self._events and (free_s <= now_s or self._events[0][0] < free_s):
                now_s, _, actor, version = heapq.heappop(self._events)
                self._playing[actor] -= 1
                self._queued[actor] += 1
                self._queue.append((actor, version))
                self._start(now_s)
            else:
                now_s = free_s

    def _start(self, now_s: float) -> None:
        windows = self.flow.windows(self._names, self._credits)
        for actor in self._names:
            while self._playing[actor] < TABS and self._playing[actor] + self._queued[actor] < windows[actor]:
                self._playing[actor] += 1
                end_s = now_s + self._step_s * int(self._rng.integers(1, 11)) * self._rng.uniform(0.8, 1.2)
                heapq.heappush(self._events, (end_s, next(self._order), actor, self.version))

    @property
    def stale_share(self) -> float:
        return self.stale / (self.stale + self.taken)


@pytest.mark.parametrize("step_s", [0.002, 0.02, 0.2], ids=["fast pages", "pages", "slow pages"])
@pytest.mark.parametrize("actors", [1, 3, 6, 50])
def test_at_most_two_in_a_hundred_episodes_are_stale(actors: int, step_s: float) -> None:
    simulation = Simulation(actors, step_s, update_s=0.1)
    simulation.run(batches=120)
    assert simulation.stale_share <= 0.02
    assert np.mean(simulation.lags) < MAX_LAG


def test_without_a_bound_most_episodes_of_many_actors_are_stale() -> None:
    simulation = Simulation(6, 0.002, update_s=0.1, credits_=64)
    simulation.flow = FlowControl(0, MAX_LAG)
    simulation.run(batches=100)
    assert simulation.stale_share > 0.3


def test_the_bound_falls_with_lag_and_grows_without() -> None:
    flow = FlowControl(BATCH, MAX_LAG)
    first = flow.outstanding
    flow.observe([MAX_LAG], stale=0)
    assert flow.outstanding < first
    low = flow.outstanding
    flow.observe([0, 1], stale=0)
    assert flow.outstanding > low
    flow.observe([0], stale=3)
    assert flow.outstanding < low + BATCH
    for _ in range(10_000):
        flow.observe([0], stale=3)
    assert flow.outstanding == MAX_LAG * BATCH
    for _ in range(1_000):
        flow.observe([MAX_LAG], stale=3)
    assert flow.outstanding == pytest.approx(BATCH / 4)


def test_stale_episodes_of_earlier_sessions_do_not_shrink_the_bound() -> None:
    flow = FlowControl(BATCH, MAX_LAG, stale=3)
    initial = flow.outstanding
    flow.observe([0], stale=3)
    assert flow.outstanding > initial


def test_actors_share_what_may_be_outstanding_and_lock_step_has_no_bound() -> None:
    flow = FlowControl(BATCH, 1)
    assert flow.windows(["b", "a", "c"], credits=256) == {"a": 11, "b": 11, "c": 10}
    assert flow.windows(["a"], credits=8) == {"a": 8}
    assert sum(flow.windows([str(n) for n in range(1000)], credits=8).values()) == BATCH
    assert FlowControl(BATCH, 0).windows(["a"], credits=8) == {"a": 8}


@pytest.mark.parametrize("wrong", [{"credits": 0}, {"max_lag": -1}, {"max_bytes": 0}, {"batch": -1}])
def test_limits_that_admit_nothing_are_an_error(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="admits no episode"):
        IngestLimits(**wrong)
