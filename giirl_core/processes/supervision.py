"""Keeps processes at work that a platform places and restarts: patient at their start, short with those that hang.

    starting --> up --(after a pause that grows)--> running --> ended --> starting ..
                                                       |
                                                       +--> silent: killed, and the platform starts another

Whoever ends CRASHES times in a row, each time soon after its start or before it was heard, is quarantined: not begun
again.
"""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable
from typing import Any, Protocol

from giirl_core.metrics import Metrics

LOG = logging.getLogger(__name__)
START_S = 120.0  # to place and start a process
CRASHES = 5
CRASH_S = 30.0  # a process that runs for so long, and was heard, did not crash at its start
PAUSE_S = 0.05  # before a process that ended begins again; four times as long with every crash
PAUSE_MAX_S = 5.0


class Gone(RuntimeError):
    """A process ended, or did not answer in time."""


class Call(Protocol):
    """One call of a method in another process."""

    def done(self) -> bool: ...

    def result(self, timeout_s: float) -> Any: ...  # raises Gone


class Process(Protocol):
    """An object in another process. A platform starts it anew when it dies."""

    reattached: bool  # it was there already: the learner before this one started it

    def call(self, method: str, *values: Any) -> Call: ...

    def kill(self, *, restart: bool) -> None: ...


class Platform(Protocol):
    """Whoever starts processes."""

    host: str  # where this process can be reached by them
    single_node: bool  # all of them on this machine, and gone when this process is

    def start(self, kind: type[Any], name: str, *values: Any, cpus: int, threads: int = ...) -> Process: ...

    def share(self, value: Any) -> Any: ...  # a value that many calls will carry

    def resources(self) -> str: ...

    def close(self) -> None: ...


class SupervisedProcess:
    """A process with one long call that should not return: when it does, `begin` makes that call again."""

    def __init__(self, name: str, process: Process, begin: Callable[[Process, int], Call], metrics: Metrics) -> None:
        self.name, self.process, self._begin, self._metrics = name, process, begin, metrics
        self.kind = name.rpartition("-")[0]
        self.restarts, self._crashes = 0, 0
        self.quarantined = ""  # why it is not started again
        self.trouble = "it has not started yet"  # what it was seen to suffer from last
        self.since_s = time.monotonic()  # when it was started, or begun
        self.running: Call | None = None
        self.leaving = False  # it was asked to end
        self.heard = True  # for those of whom something should be heard while they run: whether it was
        self._unsent: Any = None  # weights that wait for the last ones to be taken
        self._await_start(0.0)

    @property
    def healthy(self) -> bool:
        return not self.quarantined and not self.leaving

    def poll(self) -> None:
        """Begin again what ended, unless it ends as soon as it begins."""
        if self.quarantined:
            return
        if self.running is not None:
            if self.running.done() and not self.leaving:
                self._note_end(why(self.running))
        elif self.addresses is None:
            self._await_addresses()
        if self.running is None and self.addresses is not None and time.monotonic() >= self._resume_s:
            self.since_s = time.monotonic()
            self.running = self._begin(self.process, self.restarts)
        self._deliver()

    def load(self, weights: Any) -> None:
        """Send weights; those that have not been taken when newer ones come are skipped."""
        self._unsent = weights
        self._deliver()

    def notify(self, method: str, *values: Any) -> None:
        """Say something that needs no answer, to a process that runs."""
        if self.running is not None:
            self.process.call(method, *values)

    @property
    def stuck_s(self) -> float:
        """For how long it has not taken the weights that it was sent."""
        return time.monotonic() - self._loading_s if self._loading and not self._loading.done() else 0.0

    def replace(self, silence_s: float, *, heard: bool) -> None:
        """End a process that hangs, one of which something was `heard` before or not; the platform starts another."""
        self.heard = heard
        self.process.kill(restart=True)
        self._note_end(f"nothing was heard of it for {silence_s:.0f} s")

    def _await_start(self, pause_s: float) -> None:
        self.addresses: tuple[str, str] | None = None  # of its metrics and its service, once it is up
        self.running = None
        self.since_s = time.monotonic()
        self._loading: Call | None = None
        self._loading_s = 0.0
        self._unsent = None
        self._resume_s = self.since_s + pause_s
        self._asked = self.process.call("addresses")

    def _await_addresses(self) -> None:
        if self._asked.done():
            try:
                self.addresses = self._asked.result(START_S)
                return
            except Gone as trouble:  # a platform may refuse calls while it starts a process
                self.trouble = str(trouble)
                self._asked = self.process.call("addresses")
        if time.monotonic() - self.since_s > START_S:
            self.process.kill(restart=True)
            self._note_end(f"it did not start within {START_S:.0f} s: {self.trouble}")

    def _deliver(self) -> None:
        idle = self._loading is None or self._loading.done()
        if self._unsent is not None and self.running is not None and idle:
            self._loading, self._unsent = self.process.call("load", self._unsent), None
            self._loading_s = time.monotonic()

    def _note_end(self, trouble: str) -> None:
        self.trouble = trouble
        fared_well = self.running is not None and self.heard and time.monotonic() - self.since_s >= CRASH_S
        self._crashes = 1 if fared_well else self._crashes + 1
        self._metrics.worker_restarts.labels(self.kind).inc()
        if self._crashes >= CRASHES:
            self.quarantined = trouble
            LOG.error("%s is given up after ending %d times at once: %s", self.name, CRASHES, trouble)
            return
        LOG.warning("%s ended and is started again: %s", self.name, trouble)
        self.restarts += 1
        self._await_start(pause(self._crashes))


def pause(crashes: int) -> float:
    """How long to wait after so many crashes in a row; never the same, so that not all come back at once."""
    longest_s: float = min(PAUSE_S * 4 ** (crashes - 1), PAUSE_MAX_S)
    return longest_s * random.uniform(0.5, 1.0)


def why(call: Call) -> str:
    """How a call ended, in a line."""
    try:
        call.result(0.0)
    except Gone as gone:
        return str(gone)
    return "it returned"
