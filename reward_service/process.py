"""What runs inside the process of a reward service.

A replica that died is back as soon as its imports are done: it has none that only actors need, and torch, the longest,
waits until it can be addressed.
"""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor

from giirl_core.processes.worker_process import ORPHAN_TIMEOUT_S, TICK_S, WorkerProcess
from giirl_core.types import Weights
from giirl_core.wire.transport import Keys
from reward_service.service import RewardService, Scorer


class RewardProcess(WorkerProcess):
    """One process that scores."""

    def __init__(self, config: str, keys: Keys | None) -> None:
        super().__init__(config, keys)
        self._service: RewardService | None = None
        self._serves = False
        self._heard_s = time.monotonic()

    def addresses(self) -> tuple[str, str]:
        """Of the metrics, and of the socket where episodes are scored."""
        host = self.host() if self._keys else "127.0.0.1"
        self._service = self._service or RewardService(self._scorer, host=host, keys=self._keys, metrics=self._metrics)
        return self._metrics.serve(self._config.metrics.host), self._service.address

    def run(self, weights: Weights) -> None:
        """Answer until stopped; that there are no weights yet, while these are loaded."""
        service = self._service
        assert service is not None
        self._heard_s, self._serves = time.monotonic(), True
        try:
            with ThreadPoolExecutor(1) as loader:
                loading = loader.submit(service.set_first_weights, weights)
                service.serve(lambda: self._stopped.is_set() or self._orphaned or _failed(loading))
                loading.result()
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
        return time.monotonic() - self._heard_s > ORPHAN_TIMEOUT_S

    def stop(self) -> None:
        self._stopped.set()

    def _scorer(self, weights: Weights) -> Scorer:
        self._preload_thread.join()
        from giirl_core.nets.reward import build_reward

        return build_reward(self._config, weights).score


def _failed(loading: Future[None]) -> bool:
    return loading.done() and loading.exception() is not None
