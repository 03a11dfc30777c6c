"""The process of an actor: it builds the browser, the agent and the connections, and runs the worker."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from actors.browser import open_browser
from actors.episode_counter import EpisodeCounter, counter_file, delete_counts
from actors.player import training_agent
from actors.schedule import Schedule
from actors.uplink import Uplink
from actors.worker import Worker, WorkerLimits
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import MAX_ACTORS
from giirl_core.processes.worker_process import TICK_S, WorkerProcess
from giirl_core.telemetry.series import ACTOR
from giirl_core.types import Purpose
from giirl_core.weights import Weights
from giirl_core.wire.score_client import ScoreClient


class ActorProcess(WorkerProcess):
    """One actor. `run` blocks its thread until `stop`; the platform calls the other methods from other threads."""

    KIND = ACTOR

    def __init__(self, config: str, run: str, index: int, folder: Path | None, encrypted: bool) -> None:
        """`folder` is where the actor counts its episodes; None is a temporary folder on the node that it runs on."""
        name = f"actor-{index}"
        self._index, self._counter_file = index, counter_file(folder, run, name)
        self._temporary = folder is None
        self._worker: Worker | None = None
        self._weights: Weights | None = None  # the newest
        self._scorers: tuple[str, ...] = ()
        super().__init__(config, run, name, encrypted)  # last, because it starts threads

    def addresses(self) -> tuple[str, str]:
        """The address of the metrics, and the public key that this actor connects with; "" without encryption."""
        return self.metrics_address(), self._keys.public.decode() if self._keys else ""

    def run(self, incarnation: int, first: int, learner: str, scorers: tuple[str, ...], weights: Weights) -> None:
        """Play until stopped.

        `first` is the number of this actor's pages to skip: earlier incarnations may have played them. `learner` and
        `scorers` are the addresses of the ingest and of the reward services.
        """
        self.ping()
        self._running = True
        try:
            self._play(incarnation, first, learner, scorers, weights)
        finally:
            self._running = False

    def _play(self, incarnation: int, first: int, learner: str, scorers: tuple[str, ...], weights: Weights) -> None:
        config, metrics, name = self._config, self._metrics, self._name
        agent = training_agent(config)
        agent.load(weights)
        self._weights = weights
        with ExitStack() as resources:
            counter = EpisodeCounter(self._counter_file, incarnation)
            resources.callback(counter.close)
            browser = open_browser(config, metrics, tabs=config.open_pages)
            resources.callback(browser.close)
            uplink = Uplink(
                learner,
                run=self._run,
                actor=name,
                incarnation=incarnation,
                counter=counter,
                keys=self._keys,
            )
            resources.callback(uplink.close)
            client = None
            if ALGORITHMS[config.algorithm].has_learned_reward:
                client = ScoreClient(
                    self._scorers or scorers,
                    identity=f"{name}#{incarnation}",
                    timeout_s=config.actors.score_timeout_s,
                    retries=1,
                    keys=self._keys,
                )
                resources.callback(client.close)
            limits = WorkerLimits(
                step_limit=config.step_limit,
                lock_step=config.stream.policy_lag == 0,
                max_playing=config.actors.tabs,
            )
            schedule = self._lock_step(browser.tabs) if limits.lock_step else self._endless(browser.tabs, first)
            worker = Worker(browser, agent, schedule, client, uplink, limits=limits, metrics=metrics)
            self._worker = worker
            if self._weights is not weights:  # newer ones came while the browser started
                worker.load(self._weights)
            if self._stopped.is_set():
                worker.stop(0.0)
            metrics.health.ready()
            try:
                worker.run()
            finally:
                metrics.health.not_ready("its run has ended")
                self._worker = None

    def rejoin(self, incarnation: int, first: int, learner: str, scorers: tuple[str, ...], weights: Weights) -> None:
        """Work for a learner that was restarted. Returns when `run` does, or at once if it is not running."""
        self.ping()
        worker = self._worker
        self._weights = weights
        if worker is not None:
            worker.rejoin(learner, weights)
            self.set_scorers(scorers)
        while self._worker is worker is not None:
            time.sleep(TICK_S)

    def load(self, weights: Weights) -> None:
        """Use newer policy weights; while the browser starts they are kept until it is ready."""
        self.ping()
        self._weights = weights
        if self._worker is not None:
            self._worker.load(weights)

    def set_scorers(self, scorers: tuple[str, ...]) -> None:
        """Replace the addresses of the reward services."""
        self.ping()
        self._scorers = scorers
        if self._worker is not None:
            self._worker.set_scorers(scorers)

    def stop(self, commit_timeout_s: float) -> None:
        """Make `run` deliver the finished episodes and return; see `Worker.stop`."""
        self.ping()
        self._stopped.set()
        if self._worker is not None:
            self._worker.stop(commit_timeout_s)

    def forget(self) -> None:
        """Delete the count in the temporary folder of this node: a checkpoint covers all episodes of this actor."""
        self.ping()
        if self._temporary:
            delete_counts(self._counter_file)

    def silent_s(self) -> float:
        worker = self._worker
        return min(super().silent_s(), worker.learner_silent_s if worker else float("inf"))

    def _endless(self, tabs: int, first: int) -> Callable[[int], Schedule]:
        """An endless schedule of pages that no other actor plays, for any policy version."""
        return lambda version: Schedule(
            self._config.tasks,
            tabs,
            purpose=Purpose.TRAIN,
            run_seed=self._config.seed,
            first=first * MAX_ACTORS + self._index,
            stride=MAX_ACTORS,
        )

    def _lock_step(self, tabs: int) -> Callable[[int], Schedule]:
        """This actor's share of the learner's batch for one policy version."""
        config, count = self._config, self._config.actors.count
        quota = config.quota
        return lambda version: Schedule(
            config.tasks,
            tabs,
            purpose=Purpose.TRAIN,
            run_seed=config.seed,
            first=version * quota + self._index,
            stride=count,
            quota=len(range(self._index, quota, count)),
        )
