"""What a platform is asked once for all processes, instead of once for each: who has a place, which calls returned."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Protocol
from weakref import WeakSet

DONE_POLL_S = 0.02  # between two requests which calls have returned
PENDING_POLL_S = 1.0  # between two requests for the list of processes without a place


class RefCall(Protocol):
    """A call whose result the platform knows under a reference."""

    ref: Any


class UnfinishedCalls:
    """The calls whose results have not come. Thread-safe.

    `finished` returns those of a list of references whose results are there, in one request.
    """

    def __init__(self, finished: Callable[[list[Any]], list[Any]]) -> None:
        self._finished = finished
        self._lock = threading.Lock()
        self._calls: WeakSet[RefCall] = WeakSet()
        self._asked_s = float("-inf")

    def add(self, call: RefCall) -> None:
        """A call that was just made."""
        with self._lock:
            self._calls.add(call)

    def is_done(self, call: RefCall) -> bool:
        """Whether a call has returned, as of the last DONE_POLL_S."""
        with self._lock:
            if call in self._calls and time.monotonic() - self._asked_s > DONE_POLL_S:
                calls = {other.ref: other for other in self._calls}
                for ref in self._finished(list(calls)):
                    self._calls.discard(calls[ref])
                self._asked_s = time.monotonic()
            return call not in self._calls


class PendingActors:
    """The processes for which no node has room yet. `pending` requests the list of their ids."""

    def __init__(self, pending: Callable[[], frozenset[str]]) -> None:
        self._pending = pending
        self._ids: frozenset[str] = frozenset()
        self._asked_s = float("-inf")

    def has(self, actor_id: str, created_s: float) -> bool:
        """Whether a process is among them; also if the list may be older than the process, created at this time."""
        if time.monotonic() - self._asked_s > PENDING_POLL_S:
            self._asked_s, self._ids = time.monotonic(), self._pending()
        return actor_id in self._ids or self._asked_s < created_s + PENDING_POLL_S
