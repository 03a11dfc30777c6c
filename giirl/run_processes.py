"""What runs inside the processes of an actor and of the reward service, whoever starts them."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import torch

from actors.choosers import NetChooser
from actors.rollouts import Schedule
from actors.tally import Tally
from actors.uplink import Uplink, UplinkLimits
from actors.worker import Orphaned, Worker, WorkerLimits
from giirl.config import MAX_ACTORS, Config
from giirl.config_file import parse_config
from giirl.language import load_vectors
from giirl.metrics import Metrics
from giirl.reward import build_policy, build_reward
from giirl.run_browser import open_browser
from giirl.score_client import ScoreClient
from giirl.spec import Purpose, Weights
from giirl.transport import Keys
from reward_service.service import RewardService, Scorer

ORPHAN_S = 900.0  # without a word of any learner
TICK_S = 0.1


def settle(config: str) -> Config:
    """The config that the driver sent; and one thread for torch, since the cores are shared.

    The words that every net needs are read while whoever wants this process hears that it is there.
    """
    torch.set_num_threads(1)
    parsed = parse_config(json.loads(config), "the driver's config")
    threading.Thread(target=load_vectors, args=(parsed.net.vectors,), daemon=True).start()
    return parsed


class ActorProcess:
    """One process that plays. `run` holds one thread until `stop`; the others are called by another."""

    def __init__(self, config: str, run: str, index: int, tally: str, keys: Keys | None) -> None:
        self._config = settle(config)
        self._run, self._index, self._tally, self._keys = run, index, Path(tally), keys
        self._metrics = Metrics()
        self._worker: Worker | None = None
        self._newest: Weights | None = None
        self._scorers: tuple[str, ...] = ()
        self._stopped = threading.Event()

    def host(self) -> str:
        """How the other processes of the run know this machine."""
        return "127.0.0.1"

    def leave(self) -> None:
        """There is nobody to work for any more."""

    def addresses(self) -> tuple[str, str]:
        """Of the metrics; an actor serves nothing else."""
        return self._metrics.serve(self._config.metrics.host), ""

    def run(self, incarnation: int, first: int, learner: str, scorers: tuple[str, ...], weights: Weights) -> None:
        """Play pages from index `first` on, until stopped."""
        config, metrics, name = self._config, self._metrics, f"actor-{self._index}"
        chooser = NetChooser(build_policy(config), load_vectors(config.net.vectors))
        chooser.load(weights)
        self._newest = weights
        with ExitStack() as open_things:
            tally = Tally(self._tally, incarnation)
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
                step_limit=config.step_limit, lock_step=config.stream.policy_lag == 0, orphan_s=ORPHAN_S
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


class RewardProcess:
    """One process that scores."""

    def __init__(self, config: str, keys: Keys | None) -> None:
        self._config, self._keys = settle(config), keys
        self._metrics = Metrics()
        self._service: RewardService | None = None
        self._serves = False
        self._stopped = threading.Event()
        self._heard_s = time.monotonic()

    def host(self) -> str:
        """How the other processes of the run know this machine."""
        return "127.0.0.1"

    def leave(self) -> None:
        """There is nobody to work for any more."""

    def addresses(self) -> tuple[str, str]:
        """Of the metrics, and of the socket where episodes are scored."""
        host = self.host() if self._keys else "127.0.0.1"
        self._service = self._service or RewardService(self._scorer, host=host, keys=self._keys, metrics=self._metrics)
        return self._metrics.serve(self._config.metrics.host), self._service.address

    def run(self, weights: Weights) -> None:
        """Answer until stopped."""
        service = self._service
        assert service is not None
        self.load(weights)
        self._serves = True
        try:
            service.serve(lambda: self._stopped.is_set() or self._orphaned)
        finally:
            self._service, self._serves = None, False
        if self._orphaned:
            self.leave()

    def rejoin(self, weights: Weights) -> None:
        """A learner came back: its weights count from anew. Returns when `run` does, or at once when nothing runs."""
        service = self._service
        if service is not None and self._serves:
            self._heard_s = time.monotonic()
            service.set_weights(weights, anew=True)
        while self._serves:
            time.sleep(TICK_S)

    def load(self, weights: Weights) -> None:
        self._heard_s = time.monotonic()
        if self._service is not None:
            self._service.set_weights(weights)

    @property
    def _orphaned(self) -> bool:
        return time.monotonic() - self._heard_s > ORPHAN_S

    def stop(self) -> None:
        self._stopped.set()

    def _scorer(self, weights: Weights) -> Scorer:
        return build_reward(self._config, weights).score
