"""Supervises worker processes: starts them, restarts them with backoff, kills those that hang, quarantines crash loops.

    waiting for a place --> starting --> running --> exited --(backoff)--> waiting for a place ...
        |                      |            |
        |                      |            +--> hung: killed
        |                      +--> not started in time: killed
        +--> no place before the deadline: given up

A platform (see `Platform`) places the processes. Waiting for a place is no crash: it may take hours. After MAX_CRASHES
crashes in a row a process is quarantined: it is not restarted any more. Every exit counts as a crash. A stable run
(STABLE_RUN_S or longer, with a heartbeat) resets the count, so that its exit is the first crash of a new row.
"""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from giirl_core.metrics import Metrics
from giirl_core.telemetry.series import WorkerState

LOG = logging.getLogger(__name__)
START_TIMEOUT_S = 120.0  # to start a process that has a place
MAX_CRASHES = 5  # in a row, then the process is quarantined
STABLE_RUN_S = 30.0  # a run of this length, with a heartbeat, resets the count of crashes
BACKOFF_S = 0.05  # before the first restart; four times as long after every further crash
BACKOFF_MAX_S = 5.0


class ProcessDied(RuntimeError):
    """A process exited during a call, or did not answer it in time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """What a process needs of the node that it runs on."""

    cpus: float = 0.0  # cores
    memory_bytes: int = 0
    resources: Mapping[str, float] = field(default_factory=dict)  # custom ones, such as "chrome"
    apart: bool = False  # on another node than the processes of the same kind, if there is one

    def __str__(self) -> str:
        memory = [f"{self.memory_bytes / 1e6:g} MB of memory"] if self.memory_bytes else []
        return ", ".join([f"{self.cpus:g} CPU", *memory, *(f"{n:g} {name}" for name, n in self.resources.items())])


class Call(Protocol):
    """A method call in progress in another process."""

    def done(self) -> bool: ...

    def result(self, timeout_s: float) -> Any: ...  # raises ProcessDied


class Process(Protocol):
    """An object in another process. It is never restarted: a dead or killed one is replaced by a new one."""

    reattached: bool  # the process was already there, started by an earlier learner

    def placed(self) -> bool: ...  # False while no node has room for it

    def call(self, method: str, *values: Any) -> Call: ...

    def kill(self) -> None: ...


class Platform(Protocol):
    """Starts processes, on this machine or in a cluster."""

    host: str  # address of this process, as the started processes see it
    node: str  # address of this machine, as other machines see it
    single_node: bool  # all processes run on this machine and end with this process

    # A process that is not `detached` ends with this one, also on a cluster.
    def start(
        self, kind: type[Any], name: str, *values: Any, place: Place, threads: int = ..., detached: bool = ...
    ) -> Process: ...

    def share(self, value: Any) -> Any: ...  # returns a handle that many calls can carry cheaply

    def resources(self) -> str: ...  # what is free of what there is, for a message

    def close(self) -> None: ...


class SupervisedProcess:
    """One worker process and its `run` call, which should not return; when it does, another process takes its place.

    `start` places a process, and `start_run(process, addresses)` makes its `run` call. The owner calls `poll`
    regularly. Nothing here blocks.
    """

    def __init__(
        self,
        name: str,
        start: Callable[[], Process],
        start_run: Callable[[Process, tuple[str, str]], Call],
        metrics: Metrics,
        *,
        place_timeout_s: float = float("inf"),
    ) -> None:
        self.name, self._start, self._start_run, self._metrics = name, start, start_run, metrics
        self._place_timeout_s = place_timeout_s
        self.kind = name.rpartition("-")[0]
        self.restarts, self._crashes = 0, 0  # _crashes: in a row
        self.quarantine_reason = ""
        self.last_error = "it has not started yet"
        self.running: Call | None = None  # the `run` call
        self.stopping = False  # it was asked to exit
        self.heartbeat_received = True  # during this run; set by the owner if the process sends heartbeats
        self._next_weights: Any = None  # not sent yet: the process is still loading earlier weights
        self._backoff_end_s = 0.0
        self._addresses_call: Call | None = None  # None: there is no process, only the wait for the next one
        self._launch()

    @property
    def quarantined(self) -> bool:
        return bool(self.quarantine_reason)

    @property
    def healthy(self) -> bool:
        return not self.quarantined and not self.stopping

    @property
    def state(self) -> WorkerState:
        """What the process does, in one word."""
        if self.quarantined:
            return "given_up"
        if self.stopping:
            return "stopping"
        if self.running is not None:
            return "running"
        return "starting" if self._placed else "waiting"

    def poll(self) -> None:
        """Advance the state machine: detect exits, restart after the backoff, send waiting weights."""
        if self.quarantined:
            return
        if self.running is not None and self.running.done() and not self.stopping:
            self._handle_exit(exit_reason(self.running))
            if self.quarantined:
                return
        if self._addresses_call is None and time.monotonic() >= self._backoff_end_s and not self.stopping:
            self._launch()
        if self._addresses_call is not None and self.addresses is None:
            self._poll_start()
        if self.running is None and self.addresses is not None:
            self.since_s = time.monotonic()
            self.running = self._start_run(self.process, self.addresses)
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
        """Kill a process that has been silent for `silence_s`; a new one takes its place."""
        self.heartbeat_received = heartbeat_received
        self._handle_exit(f"no response for {silence_s:.0f} s")

    def _launch(self) -> None:
        self.process = self._start()
        self._reset()
        self._addresses_call = self.process.call("addresses")

    def _reset(self) -> None:
        """There is no process that could run."""
        self.addresses: tuple[str, str] | None = None  # what its method `addresses` returned, once it has started
        self._addresses_call = None
        self.running = None
        self._placed = False
        self.since_s = time.monotonic()  # start of the current state: waiting, starting or running
        self._load_call: Call | None = None
        self._load_sent_s = 0.0
        self._next_weights = None

    def _poll_start(self) -> None:
        assert self._addresses_call is not None
        if self._addresses_call.done():
            try:
                self.addresses = self._addresses_call.result(START_TIMEOUT_S)
            except ProcessDied as error:
                self._handle_exit(f"it did not start: {error}")
            else:
                self._placed = True
            return
        waited_s = time.monotonic() - self.since_s
        if not self._placed and self.process.placed():
            self._placed, self.since_s = True, time.monotonic()
        elif not self._placed and waited_s > self._place_timeout_s:
            self.process.kill()
            self._quarantine(f"no node had a place for it within {self._place_timeout_s:.0f} s")
        elif self._placed and waited_s > START_TIMEOUT_S:
            self._handle_exit(f"it did not start within {START_TIMEOUT_S:.0f} s")

    def _send_weights(self) -> None:
        idle = self._load_call is None or self._load_call.done()
        if self._next_weights is not None and self.running is not None and idle:
            self._load_call, self._next_weights = self.process.call("load", self._next_weights), None
            self._load_sent_s = time.monotonic()

    def _handle_exit(self, error: str) -> None:
        self.process.kill()  # also one that returned: it would keep its place
        self.last_error = error
        ran_s = time.monotonic() - self.since_s
        stable = self.running is not None and self.heartbeat_received and ran_s >= STABLE_RUN_S
        self._crashes = 1 if stable else self._crashes + 1
        self._metrics.worker_exits.labels(self.kind).inc()
        if self._crashes >= MAX_CRASHES:
            self._quarantine(f"{error}, {MAX_CRASHES} times in a row")
            return
        LOG.warning("%s exited and is restarted: %s", self.name, error)
        self.restarts += 1
        self._reset()
        self._backoff_end_s = self.since_s + backoff_s(self._crashes)

    def _quarantine(self, reason: str) -> None:
        self._reset()
        self.last_error = self.quarantine_reason = reason
        LOG.error("%s is given up: %s", self.name, reason)


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
