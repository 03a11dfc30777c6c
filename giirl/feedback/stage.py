"""The window in which a person shows the right way through a page, recorded as `giirl demos record` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from threading import Lock, Thread
from typing import Protocol

from browser_farm.chrome.devtools import BrowserGone
from browser_farm.human.steps import Interrupted
from giirl.feedback.selector import Candidate
from giirl_core.files import explain
from giirl_core.gestures import BASIC, Gesture
from giirl_core.types import Episode, EpisodeSpec, Trajectory

CLOSE_TIMEOUT_S = 60.0


class Recording(Protocol):
    """What the stage uses of a `Recorder`."""

    def record(self, spec: EpisodeSpec, show_instruction: Callable[[str], None], /) -> Episode | None: ...

    def close(self) -> None: ...


@dataclass(slots=True)
class Take:
    """One person showing the way of one episode: under way, done (`shown`) or failed (`error`)."""

    candidate: Candidate
    wrong_from: int  # what the person had marked and typed before
    right_for: str
    shown: Trajectory | None = None
    error: str = ""
    cancelled: bool = False

    @property
    def under_way(self) -> bool:
        return self.shown is None and not self.error


class Stage:
    """One window at a time, whoever asks for it. It waits as long as the person takes."""

    def __init__(
        self,
        open_recorder: Callable[[str], Recording],
        check: Callable[[str], None],
        gestures: Sequence[Gesture] = BASIC,
    ) -> None:
        """`open_recorder` opens the window for a task; `check` raises ValueError if the task cannot be shown there.

        `gestures` are those that the run learns. A way with any other is refused.
        """
        self._open_recorder, self._check, self._gestures = open_recorder, check, gestures
        self._lock = Lock()
        self._takes: dict[str, Take] = {}  # by key of the episode
        self._recorder: Recording | None = None  # while its window is open
        self._thread: Thread | None = None

    def take_of(self, key: str) -> Take | None:
        """The latest take of an episode that was not ended by `drop`: a copy, which does not change any more."""
        take = self._takes.get(key)
        return replace(take) if take is not None else None

    def start(self, candidate: Candidate, wrong_from: int, right_for: str) -> None:
        """Open the window. ValueError if the task cannot be shown, or while another take is under way."""
        self._check(candidate.view.task)
        with self._lock:
            if any(take.under_way for take in self._takes.values()):
                raise ValueError("another page is being shown in the window: finish it first, or cancel it")
            take = self._takes[candidate.key] = Take(candidate, wrong_from, right_for)
        self._thread = Thread(target=self._record, args=(take,), daemon=True)
        self._thread.start()

    def drop(self, key: str) -> None:
        """Forget the take of an episode, and close its window."""
        with self._lock:
            take = self._takes.pop(key, None)
            if take is not None and take.under_way:
                take.cancelled = True
                if self._recorder is not None:
                    self._recorder.close()

    def close(self) -> None:
        """Forget all takes, close the window and wait for its end."""
        for key in list(self._takes):
            self.drop(key)
        if self._thread is not None:
            self._thread.join(CLOSE_TIMEOUT_S)

    def _record(self, take: Take) -> None:
        spec = EpisodeSpec(task=take.candidate.view.task, seed=take.candidate.view.seed)
        try:
            with closing(self._open_recorder(spec.task)) as recorder:
                with self._lock:
                    self._recorder = recorder
                if take.cancelled:
                    return
                episode = recorder.record(spec, lambda goal: None)
            if episode is None:
                raise ValueError("nothing was done in the window")
            episode.trajectory.choices(self._gestures)  # any other gesture is an error
            take.shown = episode.trajectory
        except (Interrupted, BrowserGone, ValueError, RuntimeError, OSError) as error:
            take.error = explain(error) or type(error).__name__
        finally:
            with self._lock:
                self._recorder = None
