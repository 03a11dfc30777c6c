"""An actor at work: plays without a pause, has each episode scored while the next go on, streams it to the learner."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from actors.agents import PolicyAgent
from actors.rollouts import Schedule, play
from actors.uplink import Refused, Uplink
from giirl_core.metrics import Metrics, waiting
from giirl_core.types import UNSCORED, Browser, Episode, Weights
from giirl_core.wire.score_client import ScoreClient

LOG = logging.getLogger(__name__)
UNPLAYED = -1
PAUSE_S = 0.005  # between two looks at the sockets while the learner takes nothing


class Orphaned(RuntimeError):
    """There is no learner any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerLimits:
    """When an actor stops playing, and how long it stays to hand over."""

    step_limit: int
    lock_step: bool = False  # play a share of pages by each version of the weights, then wait for the next
    max_scoring: int = 64  # episodes under way to the reward service; more and the actor waits for it
    flush_s: float = 2.0  # when told to stop: for scores still to come, and again to deliver what is finished
    orphan_s: float = float("inf")  # without a word of the learner: then the actor gives up


class Worker:
    """One thread plays; `load`, `follow`, `rejoin` and `stop` may be called from others."""

    def __init__(
        self,
        browser: Browser,
        chooser: PolicyAgent,
        schedule: Callable[[int], Schedule],
        scorer: ScoreClient,
        uplink: Uplink,
        *,
        limits: WorkerLimits,
        metrics: Metrics,
    ) -> None:
        self._browser, self._chooser, self._schedule = browser, chooser, schedule
        self._scorer, self._uplink = scorer, uplink
        self._limits, self._metrics = limits, metrics
        self._orders: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._settle_s = 0.0
        self._played = UNPLAYED  # in lock-step: the version whose share is played

    def load(self, weights: Weights) -> None:
        """Play by these from the next round on."""
        self._orders.put(lambda: self._load(weights))

    def follow(self, scorers: Sequence[str]) -> None:
        """Have episodes scored by these from now on."""
        self._orders.put(lambda: self._scorer.set_replicas(scorers))

    def rejoin(self, learner: str, weights: Weights) -> None:
        """The learner came back, there: it gets what it has not saved, and its weights count from anew."""

        def order() -> None:
            self._uplink.redirect(learner)
            self._chooser.version = self._played = UNPLAYED
            self._load(weights)

        self._orders.put(order)

    def stop(self, settle_s: float) -> None:
        """Ask `run` to hand over what is finished and return, after at most so long for a checkpoint to cover it."""
        self._settle_s = settle_s
        self._stop.set()

    def run(self) -> None:
        """Play until stopped. Episodes under way are then given up; finished ones are delivered."""
        try:
            self._play_on()
        except (Orphaned, Refused):
            raise
        except Exception:
            self._hand_over()
            raise
        self._hand_over()

    def _play_on(self) -> None:
        if self._limits.lock_step:
            while not self._stop.is_set():
                self._played = self._chooser.version
                self._play(self._schedule(self._played))
                while self._chooser.version == self._played and not self._stop.is_set():
                    self._wait("weights")
        else:
            self._play(self._schedule(self._chooser.version))

    def _hand_over(self) -> None:
        """What nobody has scored in time goes unscored."""
        deadline_s = time.monotonic() + self._limits.flush_s
        while self._scorer.pending and time.monotonic() < deadline_s:
            self._tend()
            time.sleep(PAUSE_S)
        for episode in self._scorer.cancel_pending():
            self._offer_unscored(episode)
        if self._settle_s:
            self._uplink.settle(self._settle_s)
        else:
            self._uplink.flush(self._limits.flush_s)

    def _offer_unscored(self, episode: object) -> None:
        """The learner scores it."""
        assert isinstance(episode, Episode)
        assert episode.trajectory.reward_version == UNSCORED
        self._metrics.episodes_unscored.inc()
        self._uplink.offer(episode)

    def _play(self, schedule: Schedule) -> None:
        rounds = play(
            self._browser,
            self._chooser,
            schedule,
            step_limit=self._limits.step_limit,
            metrics=self._metrics,
        )
        for finished in rounds:
            for episode in finished:
                self._scorer.submit(episode, episode.trajectory)
            self._tend()
            if not self._limits.lock_step:
                self._pause()
                self._obey()
            if self._stop.is_set():
                break

    def _tend(self) -> None:
        """Pass on what has been scored, or cannot be."""
        for episode, rewards, version in self._scorer.poll():
            if rewards is None:
                self._offer_unscored(episode)
                continue
            assert isinstance(episode, Episode)
            scored = replace(episode.trajectory, rewards=rewards, reward_version=version)
            self._uplink.offer(replace(episode, trajectory=scored))
        self._uplink.poll()
        if self._uplink.silent_for_s > self._limits.orphan_s:
            raise Orphaned(f"nothing was heard of the learner for {self._limits.orphan_s:.0f} s")

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
            self._obey()

    def _obey(self) -> None:
        """Do what other threads asked for."""
        while not self._orders.empty():
            self._orders.get_nowait()()

    def _load(self, weights: Weights) -> None:
        """Swap to weights that are newer, and whole."""
        try:
            self._chooser.load(weights)
        except ValueError as error:
            self._metrics.weights_refused.labels("policy").inc()
            LOG.warning("refused weights: %s", error)
            return
        self._metrics.policy_version.set(weights.version)
