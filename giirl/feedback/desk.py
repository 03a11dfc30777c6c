"""Hands each episode to one window at a time, and keeps the answers, each in a file of its own."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from threading import Condition

from giirl.feedback.selector import Candidate
from giirl_core.types import Goal, Trajectory
from giirl_core.wire.answers import RIGHT, SUFFIX, Answer, write_answer

LOW = 4  # fewer waiting episodes than this: more are wanted
LEASE_S = 1800.0  # a window that shows nothing new for this long gives its episode back
MAX_KEPT = 500  # answered episodes of this session that can be answered again


class Desk:
    """The episodes to ask about, for any number of windows, which are named by any text. For several threads.

    Answers are in `folder`, which is made when the first one is written.
    """

    def __init__(self, folder: Path, now: Callable[[], float] = time.monotonic) -> None:
        self._folder, self._now = folder, now
        self._waiting: deque[Candidate] = deque()
        self._lent: dict[str, tuple[Candidate, float]] = {}  # by window: its episode, and since when
        self._seen: dict[str, Candidate] = {}  # by key: every episode that was lent, the newest last
        self._changed = Condition()

    @property
    def answers(self) -> int:
        """The number of answers in the folder, those of earlier sessions included."""
        return len(list(self._folder.glob(f"*{SUFFIX}")))

    def wait_until_low(self, timeout_s: float) -> bool:
        """Whether more episodes are wanted, as soon as they are or after the timeout."""
        with self._changed:
            return self._changed.wait_for(lambda: len(self._waiting) < LOW, timeout_s)

    def offer(self, candidates: Iterable[Candidate]) -> None:
        """More episodes to ask about, the most urgent first."""
        with self._changed:
            self._waiting += candidates

    def take(self, window: str) -> Candidate | None:
        """The episode of a window: the one that it has, else the next one, which no other window has.

        None while there is none.
        """
        with self._changed:
            self._end_old_leases()
            if window in self._lent:
                candidate, _ = self._lent[window]
            elif self._waiting:
                candidate = self._waiting.popleft()
            else:
                return None
            self._lent[window] = candidate, self._now()
            self._seen.pop(candidate.key, None)
            self._seen[candidate.key] = candidate
            while len(self._seen) > MAX_KEPT:
                del self._seen[next(iter(self._seen))]
            self._changed.notify_all()
            return candidate

    def skip(self, key: str) -> None:
        """Nobody answers about this episode."""
        with self._changed:
            self._give_up(key)

    def answer(
        self,
        key: str,
        *,
        wrong_from: int = RIGHT,
        right_for: str = "",
        shown: Trajectory | None = None,
    ) -> Answer:
        """Write the answer about an episode that was lent; it replaces an earlier one.

        The parameters are those of `Answer`. ValueError, and the window keeps its episode, if they make no answer.
        LookupError if no window of this session had the episode.
        """
        with self._changed:
            candidate = self._seen[key]
            goal = Goal(right_for) if right_for.strip() else None
            answer = Answer(episode=candidate.trajectory, wrong_from=wrong_from, right_for=goal, shown=shown)
            self._folder.mkdir(exist_ok=True)
            write_answer(self._folder, answer)
            self._give_up(key)
            return answer

    def lent(self, key: str) -> Candidate:
        """An episode that was lent; LookupError if it was not."""
        with self._changed:
            return self._seen[key]

    def _give_up(self, key: str) -> None:
        """Neither a window has this episode any more, nor does it wait for one."""
        self._lent = {window: lease for window, lease in self._lent.items() if lease[0].key != key}
        self._waiting = deque(candidate for candidate in self._waiting if candidate.key != key)
        self._changed.notify_all()

    def _end_old_leases(self) -> None:
        """Episodes of windows that were closed wait again, before all others."""
        for window, (candidate, since_s) in list(self._lent.items()):
            if self._now() - since_s > LEASE_S:
                del self._lent[window]
                self._waiting.appendleft(candidate)
