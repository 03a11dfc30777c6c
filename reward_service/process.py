"""The process of a reward service.

Its imports are kept few, so that a replica that died is back soon: it imports nothing that only actors need, and it
has an address before the import of torch, the slowest one, is complete.
"""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor

from giirl_core.processes.worker_process import TICK_S, WorkerProcess
from giirl_core.telemetry.series import SERVICE
from giirl_core.weights import Weights
from reward_service.service import RewardService, Scorer


class RewardProcess(WorkerProcess):
    """One reward service. `run` blocks its thread until `stop`; other threads call the other methods."""

    KIND = SERVICE

    def __init__(self, config: str, run: str, name: str, encrypted: bool) -> None:
        self._service: RewardService | None = None
        super().__init__(config, run, name, encrypted)  # last, because it starts threads

    def addresses(self) -> tuple[str, str]:
        """The addresses of the metrics and of the socket for score requests."""
        host = self.host() if self._keys else "127.0.0.1"
        self._service = self._service or RewardService(self._scorer, host=host, keys=self._keys, metrics=self._metrics)
        return self.metrics_address(), self._service.address

    def run(self, weights: Weights, clients: tuple[str, ...]) -> None:
        """Serve until stopped. While `weights` are being loaded, requests get the reply that there are none yet.

        `clients` are the public keys of the actors, if connections are encrypted.
        """
        service = self._service
        assert service is not None
        self.allow(clients)
        self.ping()
        self._running = True
        try:
            with ThreadPoolExecutor(1) as loader:
                loading = loader.submit(service.set_first_weights, weights)
                service.serve(lambda: self._stopped.is_set() or _failed(loading))
                loading.result()
        finally:
            self._service, self._running = None, False

    def rejoin(self, weights: Weights, clients: tuple[str, ...]) -> None:
        """Work for a learner that was restarted. Returns when `run` does, or at once if it is not running."""
        self.ping()
        service = self._service
        if service is not None and self._running:
            self.allow(clients)
            service.set_weights(weights, allow_older=True)
        while self._running:
            time.sleep(TICK_S)

    def allow(self, clients: tuple[str, ...]) -> None:
        """Accept connections of actors with these public keys only."""
        self.ping()
        if self._service is not None and self._keys is not None:
            self._service.allow([key.encode() for key in clients])

    def load(self, weights: Weights) -> None:
        """Use newer reward weights."""
        self.ping()
        if self._service is not None:
            self._service.set_weights(weights)

    def stop(self) -> None:
        """Make `run` return."""
        self.ping()
        self._stopped.set()

    def _scorer(self, weights: Weights) -> Scorer:
        self._preload_thread.join()
        from giirl_core.nets.reward import build_reward

        return build_reward(self._config, weights).score


def _failed(loading: Future[None]) -> bool:
    return loading.done() and loading.exception() is not None
