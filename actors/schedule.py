"""Decides which episodes are played, and which of those that were lost are played again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from giirl_core.types import EpisodeSpec, Purpose, page_seed


class Schedule:
    """Decides which episode each tab plays next. Each tab has a fixed set of tasks, and tasks share the tabs equally.

    Episode `i` of a task has seed `page_seed(purpose, run_seed, first + i * stride)`. With a `quota`, each task is
    played that many times; without one the schedule never ends.
    """

    EPISODES_PER_TURN = 10  # of one task before a tab changes to its next one, if there are more tasks than tabs
    MAX_LOSSES = 3  # an episode that was lost this often is not played again
    MAX_UNOPENED = 10  # pages of a task that do not open, one after the other, before the task is given up

    def __init__(
        self,
        tasks: Sequence[str],
        tabs: int,
        *,
        purpose: Purpose,
        run_seed: int,
        first: int = 0,
        stride: int = 1,
        quota: int | None = None,
    ) -> None:
        self._tasks_of_tab = [
            tasks[tab::tabs] if len(tasks) > tabs else [tasks[tab % len(tasks)]] for tab in range(tabs)
        ]
        self.purpose, self._run_seed, self._first, self._stride = purpose, run_seed, first, stride
        self._quota = quota
        self._started = dict.fromkeys(tasks, 0)  # number of episodes of each task
        self._started_by_tab = [0] * tabs
        self._requeued: list[EpisodeSpec] = []
        self._losses: Counter[EpisodeSpec] = Counter()
        self._unopened: Counter[str] = Counter()  # since a page of the task last opened

    def next(self, tab: int) -> EpisodeSpec | None:
        """The tab's next episode; None when the quota of its tasks is reached."""
        tasks = self._tasks_of_tab[tab]
        for spec in self._requeued:
            if spec.task in tasks and not self._is_given_up(spec.task):
                self._requeued.remove(spec)
                return spec
        open_tasks = [task for task in tasks if not self._is_over(task)]
        if not open_tasks:
            return None
        task = open_tasks[self._started_by_tab[tab] // self.EPISODES_PER_TURN % len(open_tasks)]
        self._started_by_tab[tab] += 1
        index = self._first + self._started[task] * self._stride
        self._started[task] += 1
        return EpisodeSpec(task=task, seed=page_seed(self.purpose, self._run_seed, index))

    def opened(self, spec: EpisodeSpec) -> None:
        """The page of an episode has opened."""
        self._unopened[spec.task] = 0

    def requeue(self, spec: EpisodeSpec) -> None:
        """Play a lost episode again, unless it was lost MAX_LOSSES times, because some pages break every browser."""
        self._losses[spec] += 1
        if self._losses[spec] < self.MAX_LOSSES:
            self._requeued.append(spec)

    def requeue_unopened(self, spec: EpisodeSpec, reason: str) -> None:
        """Play an episode again whose page did not open, or give the task up after MAX_UNOPENED of them.

        Then its remaining pages are missing. RuntimeError in training, which cannot do without a task.
        """
        self._unopened[spec.task] += 1
        if self._is_given_up(spec.task) and self.purpose is Purpose.TRAIN:
            raise RuntimeError(
                f"{self.MAX_UNOPENED} pages of {spec.task} in a row did not open, the last one: {reason}"
            )
        self.requeue(spec)

    def _is_given_up(self, task: str) -> bool:
        return self._unopened[task] >= self.MAX_UNOPENED

    def _is_over(self, task: str) -> bool:
        return self._is_given_up(task) or (self._quota is not None and self._started[task] >= self._quota)
