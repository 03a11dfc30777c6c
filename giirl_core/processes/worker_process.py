"""The base class of the worker processes (actors and reward services), independent of the platform that runs them."""

from __future__ import annotations

import json
import threading

from giirl_core.config_file import parse_config
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.wire.transport import Keys

ORPHAN_TIMEOUT_S = 900.0  # a process that hears of no learner for this long exits
TICK_S = 0.1  # between two checks of a condition


class WorkerProcess:
    """One worker process. Slow imports and files load in the background, so that its first call returns early."""

    def __init__(self, config: str, keys: Keys | None) -> None:
        self._config, self._keys = parse_config(json.loads(config), "the driver's config"), keys
        self._metrics = Metrics()
        self._stopped = threading.Event()
        self._preload_thread = threading.Thread(target=self._preload, daemon=True)
        self._preload_thread.start()

    def host(self) -> str:
        """The address of this machine, as the other processes of the run see it."""
        return "127.0.0.1"

    def leave(self) -> None:
        """Exit for good: there is no learner any more. Platforms override this; without one it does nothing."""

    def _preload(self) -> None:
        """Load the word vectors and torch. Torch gets one thread, because the processes share the cores."""
        vectors = threading.Thread(target=load_vectors, args=(self._config.net.vectors,), daemon=True)
        vectors.start()
        import torch

        torch.set_num_threads(1)
        vectors.join()
