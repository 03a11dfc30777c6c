"""Sends new weights to many processes from a thread of its own, so that the learner does not wait for it."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from typing import Any

from giirl_core.processes.supervision import Call, Process

RETRY_S = 0.05  # between two attempts at processes that still load earlier weights
CLOSE_TIMEOUT_S = 5.0


class Broadcast:
    """Every process gets the newest weights. While it loads some it gets no others, and skips those in between."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._weights: Any = None
        self._waiting: dict[Process, None] = {}  # those without the newest weights, in the order in which they get them
        self._calls: dict[Process, Call] = {}  # the last call of each process, the latest call at the end
        self._error: Exception | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="broadcast", daemon=True)
        self._thread.start()

    def send(self, weights: Any, processes: Iterable[Process]) -> None:
        """Send weights to these processes, and to no others from now on. Does not block.

        Raises RuntimeError when the thread has failed.
        """
        with self._changed:
            if self._error:
                raise RuntimeError(f"weights cannot be sent any more: {self._error!r}") from self._error
            processes = dict.fromkeys(processes)
            self._calls = {process: call for process, call in self._calls.items() if process in processes}
            new = {process: None for process in processes if process not in self._calls}
            self._weights, self._waiting = weights, {**new, **dict.fromkeys(self._calls)}
            self._changed.notify()

    def close(self) -> None:
        """Send nothing any more."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        try:
            while not self._closed:
                with self._changed:
                    self._changed.wait_for(lambda: self._closed or bool(self._waiting))
                    round_ = list(self._waiting)
                sent = [self._send_to(process) for process in round_]
                if not any(sent):
                    with self._changed:  # all still load earlier weights
                        self._changed.wait(RETRY_S)
        except Exception as error:  # noqa: BLE001 - `send` raises it
            with self._changed:
                self._error = error

    def _send_to(self, process: Process) -> bool:
        """Send the newest weights, unless the process still loads earlier ones or is not to get any."""
        with self._changed:
            last = self._calls.get(process)
            if self._closed or process not in self._waiting or (last is not None and not last.done()):
                return False
            del self._waiting[process]
            weights = self._weights
        call = process.call("load", weights)
        with self._changed:
            self._calls.pop(process, None)
            self._calls[process] = call
        return True
