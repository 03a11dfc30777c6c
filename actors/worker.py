"""An actor at work: plays without a pause, has each episode scored while the next go on, streams it to the learner."""

from __future__ import annotations

import queue
import threading
import time
from dataclasses import dataclass, replace

from actors.choosers import NetChooser
from actors.rollouts import Schedule, play
from actors.uplink import Uplink
from giirl.metrics import Metrics, waiting
from giirl.score_client import ScoreClient
from giirl.spec import UNSCORED, Browser, Episode, Weights

PAUSE_S = 0.005  # between two looks at the sockets while the learner takes nothing


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerLimits:
    """When an actor stops playing, and how long it stays to hand over."""

    step_limit: int
    max_scoring: int = 64  # episodes under way to the reward service; more and the actor waits for it
    flush_s: float = 2.0  # to deliver what is finished when told to stop


class Worker:
    """One thread plays; `load` and `stop` may be called from others."""

    def __init__(
        self,
        browser: Browser,
        chooser: NetChooser,
        schedule: Schedule,
        scorer: ScoreClient,
        uplink: Uplink,
        *,
        limits: WorkerLimits,
        metrics: Metrics,
    ) -> None:
        self._browser, self._chooser, self._schedule = browser, chooser, schedule
        self._scorer, self._uplink = scorer, uplink
        self._limits, self._metrics = limits, metrics
        self._newest: queue.SimpleQueue[Weights] = queue.SimpleQueue()
        self._stop = threading.Event()

    def load(self, weights: Weights) -> None:
        """Play by these from the next round on."""
        self._newest.put(weights)

    def stop(self) -> None:
        """Ask `run` to hand over what is finished and return."""
        self._stop.set()

    def run(self) -> None:
        """Play until stopped. Episodes under way are then given up; finished ones are delivered."""
        rounds = play(
            self._browser,
            self._chooser,
            self._schedule,
            step_limit=self._limits.step_limit,
            metrics=self._metrics,
        )
        for finished in rounds:
            for episode in finished:
                self._scorer.submit(episode, episode.trajectory)
            self._tend()
            self._pause()
            self._take_weights()
            if self._stop.is_set():
                break
        deadline_s = time.monotonic() + self._limits.flush_s
        while self._scorer.pending and time.monotonic() < deadline_s:
            self._tend()
            time.sleep(PAUSE_S)
        self._uplink.flush(max(0.0, deadline_s - time.monotonic()))

    def _tend(self) -> None:
        """Pass on what has been scored; what could not be goes unscored, and the learner scores it."""
        for episode, rewards, version in self._scorer.poll():
            assert isinstance(episode, Episode)
            if rewards is not None:
                scored = replace(episode.trajectory, rewards=rewards, reward_version=version)
                episode = replace(episode, trajectory=scored)
            else:
                self._metrics.scoring_given_up.inc()
                assert episode.trajectory.reward_version == UNSCORED
            self._uplink.offer(episode)
        self._uplink.poll()

    def _pause(self) -> None:
        """Hold still while the learner, or the reward service, has more than it can take."""
        while not self._stop.is_set() and not self._uplink.ready:
            self._wait("learner")
        while not self._stop.is_set() and self._scorer.pending > self._limits.max_scoring:
            self._wait("reward_service")

    def _wait(self, what: str) -> None:
        with waiting(self._metrics, what):
            time.sleep(PAUSE_S)
            self._tend()

    def _take_weights(self) -> None:
        """Swap to the newest weights that have come, skipping those between."""
        newest = None
        while not self._newest.empty():
            newest = self._newest.get_nowait()
        if newest is not None and newest.version > self._chooser.version:
            self._chooser.load(newest)
            self._metrics.policy_version.set(newest.version)
