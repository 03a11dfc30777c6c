"""What the processes that work for a learner have in common, whoever starts them."""

from __future__ import annotations

import json
import threading

from giirl_core.config_file import parse_config
from giirl_core.metrics import Metrics
from giirl_core.nets.language import load_vectors
from giirl_core.wire.transport import Keys

ORPHAN_S = 900.0  # without a word of any learner
TICK_S = 0.1


class WorkerProcess:
    """One process. What takes it longest is read while whoever wants this process hears that it is there."""

    def __init__(self, config: str, keys: Keys | None) -> None:
        self._config, self._keys = parse_config(json.loads(config), "the driver's config"), keys
        self._metrics = Metrics()
        self._stopped = threading.Event()
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def host(self) -> str:
        """How the other processes of the run know this machine."""
        return "127.0.0.1"

    def leave(self) -> None:
        """There is nobody to work for any more."""

    def _read(self) -> None:
        """The words that every net needs; and torch, with one thread, since the cores are shared."""
        words = threading.Thread(target=load_vectors, args=(self._config.net.vectors,), daemon=True)
        words.start()
        import torch

        torch.set_num_threads(1)
        words.join()
