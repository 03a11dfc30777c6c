"""What runs inside the processes of an actor and of the reward service, whoever starts them."""

from __future__ import annotations

import json
import threading
import time
from contextlib import ExitStack

import torch

from actors.choosers import NetChooser
from actors.rollouts import Schedule
from actors.uplink import Uplink, UplinkLimits
from actors.worker import Worker, WorkerLimits
from giirl.config import Config, parse_config
from giirl.language import load_vectors
from giirl.metrics import Metrics
from giirl.reward import build_policy, build_reward
from giirl.run_browser import open_browser
from giirl.score_client import ScoreClient
from giirl.spec import Purpose, Weights
from giirl.transport import Keys
from reward_service.service import RewardService, Scorer

PORT_S = 20.0  # for a port that another process of this machine was given in the meantime


def settle(config: str) -> Config:
    """The config that the driver sent; and one thread for torch, since the cores are shared."""
    torch.set_num_threads(1)
    return parse_config(json.loads(config), "the driver's config")


class ActorProcess:
    """One Ray process that plays. `run` holds one thread until `stop`; weights come in by another."""

    def __init__(self, config: str, run: str, index: int, keys: Keys | None) -> None:
        self._config = settle(config)
        self._run, self._index, self._keys = run, index, keys
        self._metrics = Metrics()
        self._worker: Worker | None = None
        self._newest: Weights | None = None
        self._stopped = threading.Event()

    def metrics_address(self) -> str:
        return self._metrics.serve(self._config.metrics.host)

    def run(self, incarnation: int, first: int, learner: str, scorer: str, weights: Weights) -> None:
        """Play pages from index `first` on, until stopped."""
        config, metrics = self._config, self._metrics
        chooser = NetChooser(build_policy(config), load_vectors(config.net.vectors))
        chooser.load(weights)
        name, count = f"actor-{self._index}", config.actors.count
        with ExitStack() as open_things:
            browser = open_browser(config, metrics)
            open_things.callback(browser.close)
            schedule = Schedule(
                config.tasks,
                browser.tabs,
                purpose=Purpose.TRAIN,
                run_seed=config.seed,
                first=-(-first // count) * count + self._index,  # pages of this actor alone
                stride=count,
            )
            uplink = Uplink(
                learner,
                run=self._run,
                actor=name,
                incarnation=incarnation,
                limits=UplinkLimits(pause_at=config.stream.credits),
                keys=self._keys,
            )
            open_things.callback(uplink.close)
            client = ScoreClient(
                scorer,
                identity=f"{name}#{incarnation}",
                timeout_s=config.actors.score_timeout_s,
                keys=self._keys,
            )
            open_things.callback(client.close)
            limits = WorkerLimits(step_limit=config.step_limit)
            worker = Worker(browser, chooser, schedule, client, uplink, limits=limits, metrics=metrics)
            self._worker = worker
            if self._newest is not None:
                worker.load(self._newest)
            if self._stopped.is_set():
                worker.stop()
            worker.run()

    def load(self, weights: Weights) -> None:
        """Newer weights; those that come while the browser starts wait for it."""
        self._newest = weights
        if self._worker is not None:
            self._worker.load(weights)

    def stop(self) -> None:
        self._stopped.set()
        if self._worker is not None:
            self._worker.stop()


class RewardProcess:
    """One Ray process that scores."""

    def __init__(self, config: str) -> None:
        self._config = settle(config)
        self._metrics = Metrics()
        self._service: RewardService | None = None
        self._stopped = threading.Event()

    def metrics_address(self) -> str:
        return self._metrics.serve(self._config.metrics.host)

    def open(self, host: str, port: int, keys: Keys | None) -> str:
        """Bind; a service that was started anew takes its old port again, as soon as whoever has it lets go."""
        deadline_s = time.monotonic() + PORT_S
        while True:
            try:
                self._service = RewardService(self._scorer, host=host, port=port, keys=keys, metrics=self._metrics)
                return self._service.address
            except ValueError:
                if time.monotonic() > deadline_s:
                    raise
                time.sleep(0.1)

    def run(self) -> None:
        """Answer until stopped."""
        assert self._service is not None
        self._service.serve_forever(self._stopped)

    def load(self, weights: Weights) -> None:
        assert self._service is not None
        self._service.set_weights(weights)

    def stop(self) -> None:
        self._stopped.set()

    def _scorer(self, weights: Weights) -> Scorer:
        return build_reward(self._config, weights).score
