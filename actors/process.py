"""What runs inside the process of an actor."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from actors.agents import PolicyAgent
from actors.browser import open_browser
from actors.episode_counter import EpisodeCounter
from actors.rollouts import Schedule
from actors.uplink import Uplink, UplinkLimits
from actors.worker import Orphaned, Worker, WorkerLimits
from giirl_core.config import MAX_ACTORS
from giirl_core.nets.language import load_vectors
from giirl_core.nets.reward import build_policy
from giirl_core.processes.worker_process import ORPHAN_TIMEOUT_S, TICK_S, WorkerProcess
from giirl_core.types import Purpose, Weights
from giirl_core.wire.score_client import ScoreClient
from giirl_core.wire.transport import Keys


class ActorProcess(WorkerProcess):
    """One process that plays. `run` holds one thread until `stop`; the others are called by another."""

    def __init__(self, config: str, run: str, index: int, tally: str, keys: Keys | None) -> None:
        super().__init__(config, keys)
        self._run, self._index, self._tally = run, index, Path(tally)
        self._worker: Worker | None = None
        self._newest: Weights | None = None
        self._scorers: tuple[str, ...] = ()

    def addresses(self) -> tuple[str, str]:
        """Of the metrics; an actor serves nothing else."""
        return self._metrics.serve(self._config.metrics.host), ""

    def run(self, incarnation: int, first: int, learner: str, scorers: tuple[str, ...], weights: Weights) -> None:
        """Play pages from index `first` on, until stopped."""
        config, metrics, name = self._config, self._metrics, f"actor-{self._index}"
        chooser = PolicyAgent(build_policy(config), load_vectors(config.net.vectors))
        chooser.load(weights)
        self._newest = weights
        with ExitStack() as open_things:
            tally = EpisodeCounter(self._tally, incarnation)
            open_things.callback(tally.close)
            browser = open_browser(config, metrics)
            open_things.callback(browser.close)
            uplink = Uplink(
                learner,
                run=self._run,
                actor=name,
                incarnation=incarnation,
                tally=tally,
                limits=UplinkLimits(pause_at=config.stream.credits),
                keys=self._keys,
            )
            open_things.callback(uplink.close)
            client = ScoreClient(
                self._scorers or scorers,
                identity=f"{name}#{incarnation}",
                timeout_s=config.actors.score_timeout_s,
                keys=self._keys,
            )
            open_things.callback(client.close)
            limits = WorkerLimits(
                step_limit=config.step_limit, lock_step=config.stream.policy_lag == 0, orphan_s=ORPHAN_TIMEOUT_S
            )
            schedule = self._share(browser.tabs) if limits.lock_step else self._pages(browser.tabs, first)
            worker = Worker(browser, chooser, schedule, client, uplink, limits=limits, metrics=metrics)
            self._worker = worker
            if self._newest is not weights:
                worker.load(self._newest)
            if self._stopped.is_set():
                worker.stop(0.0)
            try:
                worker.run()
            except Orphaned:
                self.leave()
                raise
            finally:
                if self._worker is worker:  # else another call of `run` has begun
                    self._worker = None

    def rejoin(self, incarnation: int, first: int, learner: str, scorers: tuple[str, ...], weights: Weights) -> None:
        """A learner came back: go on for it. Returns when `run` does, or at once when nothing runs."""
        worker = self._worker
        self._newest = weights
        if worker is not None:
            worker.rejoin(learner, weights)
            self.follow(scorers)
        while self._worker is worker is not None:
            time.sleep(TICK_S)

    def load(self, weights: Weights) -> None:
        """Newer weights; those that come while the browser starts wait for it."""
        self._newest = weights
        if self._worker is not None:
            self._worker.load(weights)

    def follow(self, scorers: tuple[str, ...]) -> None:
        """Where the reward services are now."""
        self._scorers = scorers
        if self._worker is not None:
            self._worker.follow(scorers)

    def stop(self, settle_s: float) -> None:
        self._stopped.set()
        if self._worker is not None:
            self._worker.stop(settle_s)

    def _pages(self, tabs: int, first: int) -> Callable[[int], Schedule]:
        """Pages that no other actor plays, for ever."""
        return lambda version: Schedule(
            self._config.tasks,
            tabs,
            purpose=Purpose.TRAIN,
            run_seed=self._config.seed,
            first=first * MAX_ACTORS + self._index,
            stride=MAX_ACTORS,
        )

    def _share(self, tabs: int) -> Callable[[int], Schedule]:
        """This actor's part of the batch that the learner takes at one version."""
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
