"""Supervises worker processes: starts them, restarts them with backoff, kills those that hang, quarantines crash loops.

    starting --> started --(backoff)--> running --> exited --> starting ...
        |                                  |
        |                                  +--> hung: killed, and the platform starts a replacement
        +--> not started in time: killed, and the platform starts a replacement

A platform (see `Platform`) places the processes. After MAX_CRASHES crashes in a row a process is quarantined: it is not
restarted any more. Every exit counts as a crash. A stable run (STABLE_RUN_S or longer, with a heartbeat) resets the
count, so that its exit is the first crash of a new row.
"""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable
from typing import Any, Protocol

from giirl_core.metrics import Metrics

LOG = logging.getLogger(__name__)
START_TIMEOUT_S = 120.0  # to place and start a process
MAX_CRASHES = 5  # in a row, then the process is quarantined
STABLE_RUN_S = 30.0  # a run of this length, with a heartbeat, resets the count of crashes
BACKOFF_S = 0.05  # before the first restart; four times as long after every further crash
BACKOFF_MAX_S = 5.0


class ProcessDied(RuntimeError):
    """A process exited during a call, or did not answer it in time."""


class Call(Protocol):
    """A method call in progress in another process."""

    def done(self) -> bool: ...

    def result(self, timeout_s: float) -> Any: ...  # raises ProcessDied


class Process(Protocol):
    """An object in another process. The platform restarts the process when it dies."""

    reattached: bool  # the process was already running, started by an earlier learner

    def call(self, method: str, *values: Any) -> Call: ...

    def kill(self, *, restart: bool) -> None: ...


class Platform(Protocol):
    """Starts processes, on this machine or in a cluster."""

    host: str  # address of this process, as the started processes see it
    node: str  # address of this machine, as other machines see it
    single_node: bool  # all processes run on this machine and end with this process

    def start(self, kind: type[Any], name: str, *values: Any, cpus: int, threads: int = ...) -> Process: ...

    def share(self, value: Any) -> Any: ...  # returns a handle that many calls can carry cheaply

    def resources(self) -> str: ...

    def close(self) -> None: ...


class SupervisedProcess:
    """One worker process and its `run` call, which should not return; when it does, the process is restarted.

    `start_run(process, restarts)` makes the `run` call; it is called again after every restart. The owner calls `poll`
    regularly. Nothing here blocks.
    """

    def __init__(
        self, name: str, process: Process, start_run: Callable[[Process, int], Call], metrics: Metrics
    ) -> None:
        self.name, self.process, self._start_run, self._metrics = name, process, start_run, metrics
        self.kind = name.rpartition("-")[0]
        self.restarts, self._crashes = 0, 0  # _crashes: in a row
        self.quarantine_reason = ""
        self.last_error = "it has not started yet"
        self.since_s = time.monotonic()  # start of the current state: starting or running
        self.running: Call | None = None  # the `run` call
        self.stopping = False  # it was asked to exit
        self.heartbeat_received = True  # during this run; set by the owner if the process sends heartbeats
        self._next_weights: Any = None  # not sent yet: the process is still loading earlier weights
        self._enter_starting(0.0)

    @property
    def quarantined(self) -> bool:
        return bool(self.quarantine_reason)

    @property
    def state(self) -> str:
        """One of `giirl_core.telemetry.series.WORKER_STATES`."""
        if self.quarantined:
            return "given_up"
        if self.stopping:
            return "stopping"
        return "starting" if self.running is None else "running"

    @property
    def healthy(self) -> bool:
        return not self.quarantined and not self.stopping

    def poll(self) -> None:
        """Advance the state machine: detect exits, restart after the backoff, send waiting weights."""
        if self.quarantined:
            return
        if self.running is not None:
            if self.running.done() and not self.stopping:
                self._handle_exit(exit_reason(self.running))
        elif self.addresses is None:
            self._poll_start()
        if self.running is None and self.addresses is not None and time.monotonic() >= self._backoff_end_s:
            self.since_s = time.monotonic()
            self.running = self._start_run(self.process, self.restarts)
        self._send_weights()

    def load(self, weights: Any) -> None:
        """Send weights. If newer weights come before these could be sent, only the newest are sent."""
        self._next_weights = weights
        self._send_weights()

    def notify(self, method: str, *values: Any) -> None:
        """Call a method and ignore its result; does nothing unless the process runs."""
        if self.running is not None:
            self.process.call(method, *values)

    @property
    def load_pending_s(self) -> float:
        """Seconds since weights were sent that the process has not loaded yet; 0 when it has."""
        return time.monotonic() - self._load_sent_s if self._load_call and not self._load_call.done() else 0.0

    def replace(self, silence_s: float, *, heartbeat_received: bool) -> None:
        """Kill a process that has been silent for `silence_s`; the platform starts a replacement."""
        self.heartbeat_received = heartbeat_received
        self.process.kill(restart=True)
        self._handle_exit(f"no response for {silence_s:.0f} s")

    def _enter_starting(self, backoff_s: float) -> None:
        self.addresses: tuple[str, str] | None = None  # of its metrics and its service, once it has started
        self.running = None
        self.since_s = time.monotonic()
        self._load_call: Call | None = None
        self._load_sent_s = 0.0
        self._next_weights = None
        self._backoff_end_s = self.since_s + backoff_s
        self._addresses_call = self.process.call("addresses")

    def _poll_start(self) -> None:
        if self._addresses_call.done():
            try:
                self.addresses = self._addresses_call.result(START_TIMEOUT_S)
                return
            except ProcessDied as error:  # a platform may refuse calls while it starts a process
                self.last_error = str(error)
                self._addresses_call = self.process.call("addresses")
        if time.monotonic() - self.since_s > START_TIMEOUT_S:
            self.process.kill(restart=True)
            self._handle_exit(f"it did not start within {START_TIMEOUT_S:.0f} s: {self.last_error}")

    def _send_weights(self) -> None:
        idle = self._load_call is None or self._load_call.done()
        if self._next_weights is not None and self.running is not None and idle:
            self._load_call, self._next_weights = self.process.call("load", self._next_weights), None
            self._load_sent_s = time.monotonic()

    def _handle_exit(self, error: str) -> None:
        self.last_error = error
        ran_s = time.monotonic() - self.since_s
        stable = self.running is not None and self.heartbeat_received and ran_s >= STABLE_RUN_S
        self._crashes = 1 if stable else self._crashes + 1
        self._metrics.worker_exits.labels(self.kind).inc()
        if self._crashes >= MAX_CRASHES:
            self.quarantine_reason = error
            LOG.error("%s is quarantined after %d crashes in a row: %s", self.name, MAX_CRASHES, error)
            return
        LOG.warning("%s exited and is restarted: %s", self.name, error)
        self.restarts += 1
        self._enter_starting(backoff_s(self._crashes))


def backoff_s(crashes: int) -> float:
    """Seconds to wait before a restart after `crashes` crashes in a row: exponential, with random jitter."""
    longest_s: float = min(BACKOFF_S * 4 ** (crashes - 1), BACKOFF_MAX_S)
    return longest_s * random.uniform(0.5, 1.0)


def exit_reason(call: Call) -> str:
    """Why a finished `run` call ended, in one line."""
    try:
        call.result(0.0)
    except ProcessDied as error:
        return str(error)
    return "it returned"
