"""The base class of the worker processes (actors and reward services), independent of the platform that runs them."""

from __future__ import annotations

import json
import threading
import time

from giirl_core.config_file import parse_config
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.telemetry.logs import configure_logs
from giirl_core.telemetry.targets import reachable
from giirl_core.wire.transport import Keys

STOPPED_TIMEOUT_S = 15.0  # a process that was stopped, and then hears nothing for this long, exits
MAX_WORKERS = 2048  # on one machine: how many ports are tried
TICK_S = 0.1  # between two checks of a condition
ORPHAN_TICK_S = 1.0  # between two checks whether the learner is still there


class WorkerProcess:
    """One worker process. Slow imports and files load in the background, so that its first call returns early.

    It exits by itself when it hears nothing of a learner for `actors.orphan_timeout_s`, whatever it does then.
    """

    KIND: str  # as `giirl_core.telemetry.series` names it

    def __init__(self, config: str, run: str, name: str, encrypted: bool) -> None:
        """`run` is the identity of the run, `name` that of the process, such as "actor-0".

        `encrypted`: connections need a key pair. This process makes its own, and only tells its public key.
        """
        self._config = parse_config(json.loads(config), "the driver's config")
        self._keys = Keys.generate() if encrypted else None
        self._metrics, self._metrics_address = Metrics(self.KIND), ""
        self._run, self._name = run, name
        configure_logs(self._config.log, run, name)
        self._stopped = threading.Event()
        self._running = False  # `run` has begun and not returned
        self._called_s = time.monotonic()
        self._preload_thread = threading.Thread(target=self._preload, daemon=True)
        self._preload_thread.start()
        threading.Thread(target=self._leave_when_orphaned, daemon=True).start()

    def host(self) -> str:
        """The address of this machine, as the other processes of the run see it."""
        return "127.0.0.1"

    def metrics_address(self) -> str:
        """The "host:port" at which the other processes reach the metrics, which are served from the first call on."""
        self.ping()
        settings = self._config.metrics
        if not self._metrics_address:
            self._metrics_address = self._metrics.serve(settings.host, settings.worker_port, ports=MAX_WORKERS)
        return reachable(self._metrics_address, self.host())

    def leave(self) -> None:
        """Exit for good: there is no learner any more. Platforms override this; without one it does nothing."""

    def ping(self) -> None:
        """Called by the learner to show that it is there, when it has called nothing else for some time."""
        self._called_s = time.monotonic()

    def silent_s(self) -> float:
        """Seconds since this process heard of its learner; `giirl clean` asks for it."""
        return time.monotonic() - self._called_s

    def _leave_when_orphaned(self) -> None:
        while self.silent_s() <= self._orphan_timeout_s:
            time.sleep(ORPHAN_TICK_S)
        self.leave()

    @property
    def _orphan_timeout_s(self) -> float:
        ended = self._stopped.is_set() and not self._running
        return min(self._config.actors.orphan_timeout_s, STOPPED_TIMEOUT_S if ended else float("inf"))

    def _preload(self) -> None:
        """Load the word vectors and torch. Torch gets one thread, because the processes share the cores."""
        vectors = threading.Thread(target=load_vectors, args=(self._config.net.vectors,), daemon=True)
        vectors.start()
        import torch

        torch.set_num_threads(1)
        vectors.join()
