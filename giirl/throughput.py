"""The throughput of a training loop: rates of episodes and steps, waiting times, policy lag and stale episodes."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import fmean

WINDOW_S = 20.0  # of the recent rates
MAX_TASKS = 8  # of more tasks, a line shows the mean and the lowest


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamState:
    """The state of the stream of episodes, as a runtime reports it."""

    stale: int = 0  # episodes dropped as stale since the start of the session
    queued: int = 0  # episodes that are accepted and not yet taken
    actors_idle: float = 0.0  # fraction of the actors' tabs that wait for the learner


@dataclass(slots=True)
class _Step:
    """One step of the learner."""

    end_s: float
    episodes: int
    env_steps: int
    waited_s: float
    lag: float  # sum over the episodes
    stale: int  # since the start of the session


class Throughput:
    """Measures rates over the last WINDOW_S and over the whole session."""

    def __init__(self) -> None:
        self._since_s = time.monotonic()
        self._waited_s = 0.0
        self._steps: deque[_Step] = deque()
        self._episodes = self._stale = 0
        self._lag = self._waited_total_s = self._idle = 0.0

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Count the time in the `with` block as waiting for rollouts."""
        since_s = time.monotonic()
        try:
            yield
        finally:
            self._waited_s += time.monotonic() - since_s

    def add(self, lags: Sequence[int], env_steps: int, state: StreamState) -> None:
        """Add one step of the learner. `lags` are those of its episodes, in policy versions."""
        now_s = time.monotonic()
        self._steps.append(_Step(now_s, len(lags), env_steps, self._waited_s, sum(lags), state.stale))
        self._episodes, self._lag = self._episodes + len(lags), self._lag + sum(lags)
        self._waited_total_s, self._waited_s = self._waited_total_s + self._waited_s, 0.0
        self._stale, self._idle = state.stale, state.actors_idle
        while len(self._steps) > 2 and now_s - self._steps[0].end_s > WINDOW_S:
            self._steps.popleft()

    def recent(self) -> dict[str, float]:
        """Rates per second, fractions of waiting, mean lag and fraction of stale episodes, over the last WINDOW_S."""
        first, steps = self._steps[0], list(self._steps)[1:]
        begin_s = first.end_s if steps else self._since_s
        steps = steps or [first]
        seconds = max(steps[-1].end_s - begin_s, 1e-6)
        episodes = sum(step.episodes for step in steps)
        stale = steps[-1].stale - (first.stale if steps[-1] is not first else 0)
        return {
            "episodes_per_s": round(episodes / seconds, 1),
            "iterations_per_s": round(len(steps) / seconds, 3),
            "env_steps_per_s": round(sum(step.env_steps for step in steps) / seconds, 1),
            "learner_waits": round(sum(step.waited_s for step in steps) / seconds, 3),
            "actors_idle": round(self._idle, 3),
            "lag": round(sum(step.lag for step in steps) / max(episodes, 1), 2),
            "stale": round(stale / max(episodes + stale, 1), 4),
        }

    def total(self) -> dict[str, float]:
        """The same over the whole session, for result.json."""
        seconds = max(time.monotonic() - self._since_s, 1e-6)
        return {
            "episodes_per_s": round(self._episodes / seconds, 1),
            "learner_waits": round(self._waited_total_s / seconds, 3),
            "lag": round(self._lag / max(self._episodes, 1), 2),
            "stale": round(self._stale / max(self._episodes + self._stale, 1), 4),
        }


def format_rates(rates: Mapping[str, float], dropped: Mapping[str, int]) -> str:
    """The recent rates as one line for the progress display, and the episodes dropped in this session by reason."""
    drops = "".join(f", {reason.replace('_', ' ')} {count}" for reason, count in dropped.items())
    return (
        f"{rates['episodes_per_s']:.0f} episodes/s, {rates['env_steps_per_s']:.0f} steps/s, "
        f"learner waits {100 * rates['learner_waits']:.0f} %, actors idle {100 * rates['actors_idle']:.0f} %, "
        f"lag {rates['lag']:.1f}, stale {100 * rates['stale']:.1f} %{drops}"
    )


def format_success(success: Mapping[str, float]) -> str:
    """The success of every task in one line; of more than MAX_TASKS, their mean and the lowest ones."""
    few = sorted(success, key=success.__getitem__)[:MAX_TASKS] if len(success) > MAX_TASKS else list(success)
    words = ", ".join(f"{task} {100 * success[task]:.0f} %" for task in few)
    if len(few) == len(success):
        return words
    return f"{100 * fmean(success.values()):.1f} % over {len(success)} tasks, lowest {words}"
