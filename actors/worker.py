"""The main loop of an actor: plays episodes, requests their rewards, and sends them to the learner.

Scoring and delivery are asynchronous: the next episodes are played in the meantime.
"""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from actors.agents import PolicyAgent
from actors.rollouts import always_open, play
from actors.schedule import Schedule
from actors.uplink import Refused, Uplink
from giirl_core.metrics import Metrics, waiting
from giirl_core.types import UNSCORED, Browser, Episode
from giirl_core.weights import Weights
from giirl_core.wire.score_client import ScoreClient

LOG = logging.getLogger(__name__)
NO_VERSION = -1
IDLE_S = 5.0  # time constant of the moving average of the share of idle tabs
POLL_S = 0.005  # between polls of the sockets while the actor does not play


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerLimits:
    """The limits at which an actor ends an episode, pauses, or stops."""

    step_limit: int  # actions per episode
    lock_step: bool = False  # play one schedule with each policy version, then wait for the next version
    max_playing: int = 1 << 10  # episodes at the same time, in whichever tabs
    max_scoring: int = 64  # while more episodes than this wait for rewards, none starts
    flush_timeout_s: float = 2.0  # after `stop`: for outstanding rewards, and again for acknowledgements


class Worker:
    """Runs in one thread. Only `load`, `set_scorers`, `rejoin` and `stop` may be called from other threads."""

    def __init__(
        self,
        browser: Browser,
        agent: PolicyAgent,
        schedule: Callable[[int], Schedule],
        scorer: ScoreClient | None,
        uplink: Uplink,
        *,
        limits: WorkerLimits,
        metrics: Metrics,
    ) -> None:
        """`schedule` returns the schedule for a policy version; without lock-step it is called only once.

        `scorer` is None for algorithms that use no learned reward.
        """
        self._browser, self._agent, self._schedule = browser, agent, schedule
        self._scorer, self._uplink = scorer, uplink
        self._limits, self._metrics = limits, metrics
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()  # from other threads
        self._stop = threading.Event()
        self._commit_timeout_s = 0.0
        self._played_version = NO_VERSION  # in lock-step: the version whose schedule was started last
        self._places = min(browser.tabs, limits.max_playing)
        self._playing = 0  # unfinished episodes
        self._idle = _MovingAverage()  # share of idle places

    @property
    def learner_silent_s(self) -> float:
        """Seconds since the learner's last message."""
        return self._uplink.silent_for_s

    def load(self, weights: Weights) -> None:
        """Use these policy weights from the next round on."""
        self._calls.put(lambda: self._load(weights))

    def set_scorers(self, scorers: Sequence[str]) -> None:
        """Replace the addresses of the reward services."""

        def call() -> None:
            if self._scorer is not None:
                self._scorer.set_replicas(scorers)

        self._calls.put(call)

    def rejoin(self, learner: str, weights: Weights) -> None:
        """Work for a learner that was restarted at this address. Its weights may be older than the current ones."""

        def call() -> None:
            self._uplink.redirect(learner)
            self._agent.version = self._played_version = NO_VERSION
            self._load(weights)

        self._calls.put(call)

    def stop(self, commit_timeout_s: float) -> None:
        """Make `run` deliver the finished episodes and return.

        With `commit_timeout_s` > 0, `run` also waits up to that long for a checkpoint that covers them.
        """
        self._commit_timeout_s = commit_timeout_s
        self._stop.set()

    def run(self) -> None:
        """Play until `stop` is called, then deliver the finished episodes. Unfinished episodes are abandoned.

        Raises Refused, and delivers nothing, if the learner rejects this actor.
        """
        try:
            self._play_until_stopped()
        except Refused:
            raise
        except Exception:
            self._deliver_finished()
            raise
        self._deliver_finished()

    def _play_until_stopped(self) -> None:
        if self._limits.lock_step:
            while not self._stop.is_set():
                self._played_version = self._agent.version
                self._play(self._schedule(self._played_version))
                while self._agent.version == self._played_version and not self._stop.is_set():
                    self._wait("weights")
        else:
            self._play(self._schedule(self._agent.version))

    def _deliver_finished(self) -> None:
        """Deliver all finished episodes; those whose rewards do not arrive in time are sent unscored."""
        deadline_s = time.monotonic() + self._limits.flush_timeout_s
        while self._scorer is not None and self._scorer.pending and time.monotonic() < deadline_s:
            self._poll()
            time.sleep(POLL_S)
        for episode in self._scorer.cancel_pending() if self._scorer is not None else ():
            self._submit_unscored(episode)
        if self._commit_timeout_s:
            self._uplink.wait_committed(self._commit_timeout_s)
        else:
            self._uplink.flush(self._limits.flush_timeout_s)

    def _submit_unscored(self, episode: object) -> None:
        """Send an episode without rewards; the learner computes them if it needs them."""
        assert isinstance(episode, Episode)
        assert episode.trajectory.reward_version == UNSCORED
        if self._scorer is not None:
            self._metrics.episodes_unscored.inc()
        self._uplink.submit(episode)

    def _play(self, schedule: Schedule) -> None:
        rounds = play(
            self._browser,
            self._agent,
            schedule,
            step_limit=self._limits.step_limit,
            metrics=self._metrics,
            gate=always_open if self._limits.lock_step else self._startable,
        )
        for finished in rounds:
            for episode in finished:
                self._finish(episode)
            self._poll()
            if not self._limits.lock_step:
                self._run_calls()
            if not finished and not self._playing:
                self._wait("learner")
            if self._stop.is_set():
                break

    def _startable(self, playing: int) -> int:
        """The gate: how many more episodes the learner's credits allow, while `playing` are unfinished."""
        self._playing = playing
        scoring = self._scorer.pending if self._scorer is not None else 0
        if scoring > self._limits.max_scoring:
            return 0
        return min(self._uplink.startable(playing + scoring), self._limits.max_playing - playing)

    def _finish(self, episode: Episode) -> None:
        """Request the rewards of an episode. If no reward service answers, send it unscored."""
        if self._scorer is None or not self._scorer.answering:
            self._submit_unscored(episode)
        else:
            self._scorer.submit(episode, episode.trajectory)

    def _poll(self) -> None:
        """Send the episodes whose scoring has succeeded or failed to the learner. Raises Refused."""
        for episode, rewards, version in self._scorer.poll() if self._scorer is not None else ():
            if rewards is None:
                self._submit_unscored(episode)
                continue
            assert isinstance(episode, Episode)
            self._uplink.submit(replace(episode, trajectory=episode.trajectory.with_rewards(rewards, version)))
        if self._scorer is not None and not self._scorer.answering:  # the learner can compute what would come late
            for episode in self._scorer.cancel_pending():
                self._submit_unscored(episode)
        self._metrics.health.beat()
        self._uplink.idle_share = self._idle.update(1 - self._playing / self._places)
        self._uplink.poll()

    def _wait(self, what: str) -> None:
        with waiting(self._metrics, what):
            time.sleep(POLL_S)
            self._poll()
            self._run_calls()

    def _run_calls(self) -> None:
        """Run the calls that other threads have queued."""
        while not self._calls.empty():
            self._calls.get_nowait()()

    def _load(self, weights: Weights) -> None:
        """Replace the policy weights; older or corrupt ones are rejected and counted."""
        try:
            self._agent.load(weights)
        except ValueError as error:
            self._metrics.weights_refused.labels("policy").inc()
            LOG.warning("rejected policy weights: %s", error)
            return
        self._metrics.policy_version.set(weights.version)


class _MovingAverage:
    """An exponential moving average over time, with the time constant IDLE_S."""

    def __init__(self) -> None:
        self._value, self._updated_s = 0.0, time.monotonic()

    def update(self, value: float) -> float:
        """Add `value` for the time since the last update; returns the average, in [0, 1]."""
        now_s = time.monotonic()
        weight = 1 - math.exp((self._updated_s - now_s) / IDLE_S)
        self._value, self._updated_s = self._value + weight * (value - self._value), now_s
        return min(max(self._value, 0.0), 1.0)
