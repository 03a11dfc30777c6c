"""How fast a training loop goes, and what it waits for."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

WINDOW_S = 20.0  # rates are over so long


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamState:
    """What a runtime knows of its stream of episodes."""

    stale: int = 0  # episodes dropped as stale since the run began
    actors_idle: float = 0.0  # share of the actors' tabs that wait for the learner


@dataclass(slots=True)
class _Step:
    end_s: float
    episodes: int
    env_steps: int
    waited_s: float
    lag: float
    stale: int


class Throughput:
    """Rates over the last steps, and over all of them."""

    def __init__(self) -> None:
        self._since_s = time.monotonic()
        self._waited_s = 0.0
        self._steps: deque[_Step] = deque()
        self._episodes = self._stale = 0
        self._lag = self._waited_total_s = self._idle = 0.0

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Count the time of the block as waiting for rollouts."""
        since_s = time.monotonic()
        try:
            yield
        finally:
            self._waited_s += time.monotonic() - since_s

    def add(self, lags: Sequence[int], env_steps: int, state: StreamState) -> None:
        """Count one step of the loop: the lag of each of its episodes, versions, and the state of the stream."""
        now_s = time.monotonic()
        self._steps.append(_Step(now_s, len(lags), env_steps, self._waited_s, sum(lags), state.stale))
        self._episodes, self._lag = self._episodes + len(lags), self._lag + sum(lags)
        self._waited_total_s, self._waited_s = self._waited_total_s + self._waited_s, 0.0
        self._stale, self._idle = state.stale, state.actors_idle
        while len(self._steps) > 2 and now_s - self._steps[0].end_s > WINDOW_S:
            self._steps.popleft()

    def recent(self) -> dict[str, float]:
        """Episodes and environment steps a second, shares of waiting, mean lag and share of stale ones, of late."""
        first, steps = self._steps[0], list(self._steps)[1:]
        begin_s = first.end_s if steps else self._since_s
        steps = steps or [first]
        seconds = max(steps[-1].end_s - begin_s, 1e-6)
        episodes = sum(step.episodes for step in steps)
        stale = steps[-1].stale - (first.stale if steps[-1] is not first else 0)
        return {
            "episodes_per_s": round(episodes / seconds, 1),
            "env_steps_per_s": round(sum(step.env_steps for step in steps) / seconds, 1),
            "learner_waits": round(sum(step.waited_s for step in steps) / seconds, 3),
            "actors_idle": round(self._idle, 3),
            "lag": round(sum(step.lag for step in steps) / max(episodes, 1), 2),
            "stale": round(stale / max(episodes + stale, 1), 4),
        }

    def total(self) -> dict[str, float]:
        """The same of the whole session, for its result."""
        seconds = max(time.monotonic() - self._since_s, 1e-6)
        return {
            "episodes_per_s": round(self._episodes / seconds, 1),
            "learner_waits": round(self._waited_total_s / seconds, 3),
            "lag": round(self._lag / max(self._episodes, 1), 2),
            "stale": round(self._stale / max(self._episodes + self._stale, 1), 4),
        }


def in_words(rates: dict[str, float]) -> str:
    """The rates as one line of progress."""
    return (
        f"{rates['episodes_per_s']:.0f} episodes/s, learner waits {100 * rates['learner_waits']:.0f} %, actors idle "
        f"{100 * rates['actors_idle']:.0f} %, lag {rates['lag']:.1f}, stale {100 * rates['stale']:.1f} %"
    )
