"""Actors and the reward service as Ray processes: on this machine, or in the cluster that the job runs in.

Ray places, starts and restarts the processes and carries weights, one object a version, fetched once a node.
Trajectories and scores go over sockets of their own (see `giirl.transport`). The learner stays in the driver.
"""

from __future__ import annotations

import json
import logging
import os
import secrets
import signal
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

import ray
from ray.exceptions import RayError

from giirl.config import Config
from giirl.config_file import dump_config
from giirl.metrics import Metrics
from giirl.run_processes import ActorProcess, RewardProcess
from giirl.spec import Episode, Weights
from giirl.transport import Keys
from learner.admission import IngestLimits
from learner.held import Held
from learner.ingest import Ingest

LOG = logging.getLogger(__name__)
START_S = 120.0  # for Ray to place and start a process
STOP_S = 10.0  # for a process to hand over and end
TEND_S = 0.5  # between two looks at the processes
CRASHES = 5  # in a row, each within CRASH_S of its start: then the process is given up
CRASH_S = 30.0
RUNTIME = "runtime.json"  # of a checkpoint


class ActorOnRay(ActorProcess):
    """An actor where Ray put it."""


class RewardOnRay(RewardProcess):
    """The reward service where Ray put it."""

    def node(self) -> str:
        """The address that the other processes of the cluster know this node by."""
        return _node()


class Member:
    """A process with one long call that should not return: when it does, `begin` makes that call again."""

    def __init__(self, name: str, handle: Any, begin: Callable[[int], Any]) -> None:
        self.name, self.handle, self._begin = name, handle, begin
        self.restarts, self._crashes = 0, 0
        self.given_up = ""  # why it is not started again
        self.address = ""  # of its metrics, once known
        self._loading: Any = None
        self.since_s = time.monotonic()
        self.running: Any = begin(0)  # None while the process is away
        self._asked = handle.metrics_address.remote()

    def tend(self) -> None:
        """Start again what ended, unless it ends as soon as it starts."""
        if self.given_up:
            return
        if self.running is not None and ray.wait([self.running], timeout=0)[0]:
            self._note_end(_why(self.running))
        elif not self.address and ray.wait([self._asked], timeout=0)[0]:
            self.address = _ask(self._asked, STOP_S)
            if not self.address:
                self._asked = self.handle.metrics_address.remote()  # Ray refuses calls while it starts a process
            elif self.running is None:
                self.since_s = time.monotonic()
                try:
                    self.running = self._begin(self.restarts)
                except RuntimeError as error:  # it ended again before it began
                    self._note_end(str(error))

    def _note_end(self, trouble: str) -> None:
        self._crashes = self._crashes + 1 if time.monotonic() - self.since_s < CRASH_S else 1
        if self._crashes >= CRASHES:
            self.given_up = trouble
            LOG.error("%s is given up after ending %d times at once: %s", self.name, CRASHES, trouble)
            return
        LOG.warning("%s ended and is started again: %s", self.name, trouble)
        self.restarts += 1
        self.address, self._loading, self.running = "", None, None
        self.since_s = time.monotonic()
        self._asked = self.handle.metrics_address.remote()

    def load(self, weights: Any) -> None:
        """Send weights, unless the last ones have not been taken yet: then these are skipped."""
        if self._loading is None or ray.wait([self._loading], timeout=0)[0]:
            self._loading = self.handle.load.remote(weights)

    def replace(self) -> None:
        """End a process that hangs; Ray starts another in its place and `tend` notices."""
        LOG.warning("%s does not answer and is replaced", self.name)
        ray.kill(self.handle, no_restart=False)
        self.since_s = time.monotonic()


class RayRuntime:
    """The processes of one run, seen from the learner."""

    def __init__(self, config: Config, metrics: Metrics, run: str, stop: Event, resume: Path | None) -> None:
        _connect(config)
        alone = config.runtime == "local"
        self._config, self._metrics, self._run, self._stop = config, metrics, run, stop
        self._host = "127.0.0.1" if alone else _node()
        self._keys = None if alone else Keys.make()  # beyond loopback nobody talks without them
        self._version = 0
        self._policy: Any = None
        self._reward: Any = None
        self._held = Held.load(resume) if resume else Held()
        self._taken: int = json.loads((resume / RUNTIME).read_text())["taken"] if resume else 0
        known = [mark.incarnation for mark in self._held.marks]
        self._first = max([int(time.time()), *(incarnation + 1 for incarnation in known)])  # incarnations only grow
        self._ingest = Ingest(
            run,
            lambda: self._version,
            reward_version=lambda: self._version,
            host=self._host,
            limits=IngestLimits(credits=config.stream.credits, max_lag=config.stream.policy_lag),
            keys=self._keys,
            metrics=metrics,
            held=self._held,
        )
        self._actors: list[Member] = []
        self._service: Member | None = None
        self._scorer = ""
        self._tended_s = 0.0

    def publish(self, policy: Weights, reward: Weights) -> None:
        """Hand new weights to everybody; the first ones start the processes."""
        self._version = policy.version
        self._policy, self._reward = ray.put(policy), ray.put(reward)
        if self._service is None:
            self._service = self._start_service()
            self._actors = [self._start_actor(index) for index in range(self._config.actors.count)]
        self._service.load(self._reward)
        for actor in self._actors:
            actor.load(self._policy)

    def take(self, episodes: int) -> list[Episode]:
        """The next `episodes` that the actors finished; none when the run should end."""
        timeout_s = self._config.stream.take_timeout_s
        deadline_s = time.monotonic() + timeout_s
        while not self._stop.is_set():
            self._tend()
            try:
                taken = self._ingest.take(episodes, TEND_S)
            except TimeoutError as error:
                if time.monotonic() > deadline_s:
                    raise RuntimeError(
                        f"fewer than {episodes} episodes came within {timeout_s:.0f} s (stream.take_timeout_s): {error}"
                    ) from None
            else:
                self._taken += len(taken)
                return taken
        return []

    def addresses(self) -> dict[str, str]:
        """Where each process answers scrapes, as far as known."""
        members = [*self._actors, *([self._service] if self._service else [])]
        return {member.name: member.address for member in members if member.address}

    def save(self, folder: Path) -> None:
        """What the learner has accepted and not used yet, and what it has seen of every actor."""
        self._held = self._ingest.snapshot()
        self._held.save(folder)
        (folder / RUNTIME).write_text(json.dumps({"taken": self._taken}))

    def committed(self) -> None:
        """The last `save` is safe on the disk: actors may forget what it covers."""
        self._ingest.committed(self._held)

    def close(self) -> None:
        """Let the processes hand over and end; whoever does not in time is ended."""
        members = [*self._actors, *([self._service] if self._service else [])]
        for member in members:
            member.handle.stop.remote()
        running = [member.running for member in members if member.running is not None]
        if running:
            ray.wait(running, num_returns=len(running), timeout=STOP_S)
        try:
            self._ingest.close()
        finally:
            ray.shutdown()

    def _start_service(self) -> Member:
        process = ray.remote(RewardOnRay).options(num_cpus=0, max_restarts=-1, max_concurrency=4)
        handle: Any = process.remote(dump_config(self._config))
        host = self._host if self._keys is None else self._place(handle.node.remote(), "the reward service")

        def begin(restarts: int) -> Any:
            port = int(self._scorer.rpartition(":")[2] or 0)
            self._scorer = self._place(handle.open.remote(host, port, self._keys), "the reward service")
            handle.load.remote(self._reward)
            return handle.run.remote()

        return Member("reward-service", handle, begin)

    def _start_actor(self, index: int) -> Member:
        process = ray.remote(ActorOnRay).options(num_cpus=1, max_restarts=-1, max_concurrency=4)
        handle: Any = process.remote(dump_config(self._config), self._run, index, self._keys)

        def begin(restarts: int) -> Any:
            incarnation = self._first + restarts
            return handle.run.remote(incarnation, self._taken, self._ingest.address, self._scorer, self._policy)

        return Member(f"actor-{index}", handle, begin)

    def _tend(self) -> None:
        """Start again what ended and replace what hangs; too few actors end the run."""
        if time.monotonic() - self._tended_s < TEND_S:
            return
        self._tended_s = time.monotonic()
        assert self._service is not None
        patience_s = self._config.actors.silence_s
        for actor in self._actors:
            actor.tend()
            idle_s = time.monotonic() - actor.since_s
            if min(idle_s - START_S, self._ingest.silent_for_s(actor.name)) > patience_s and not actor.given_up:
                actor.replace()
        self._service.tend()
        if self._service.given_up:
            raise RuntimeError(f"the reward service does not stay up: {self._service.given_up}")
        healthy = [actor for actor in self._actors if not actor.given_up]
        if len(healthy) < min(self._config.actors.minimum, len(self._actors)):
            trouble = next(actor.given_up for actor in self._actors if actor.given_up)
            raise RuntimeError(
                f"{len(healthy)} of {len(self._actors)} actors are left, "
                f"wanted {self._config.actors.minimum} (actors.minimum): {trouble}"
            )

    def _place(self, answer: Any, what: str) -> str:
        """Wait for a process's first answer."""
        found = _ask(answer, START_S)
        if not found:
            raise RuntimeError(f"{what} did not start within {START_S:.0f} s: {_why(answer)}; Ray has {_resources()}")
        return found


def _connect(config: Config) -> None:
    """Start Ray on this machine alone, or join the cluster that this process was started in."""
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    terminated = signal.getsignal(signal.SIGTERM)
    _init(config, quiet)
    signal.signal(signal.SIGTERM, terminated)  # Ray puts its own in place, which ends a run unsaved


def _init(config: Config, quiet: dict[str, Any]) -> None:
    if config.runtime == "ray":
        ray.init(address="auto", **quiet)
        return
    if "RAY_AUTH_MODE" not in os.environ:  # a key for this run alone, which Ray then does not write to the disk
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    ray.init(
        address="local",
        num_cpus=config.actors.count,
        include_dashboard=False,
        object_store_memory=256 << 20,
        **quiet,
    )


def _resources() -> str:
    return str(ray.cluster_resources())  # type: ignore[no-untyped-call]


def _node() -> str:
    return str(ray.util.get_node_ip_address())  # type: ignore[no-untyped-call]


def _ask(answer: Any, timeout_s: float) -> str:
    """What a process says, "" when it does not."""
    try:
        return str(ray.get(answer, timeout=timeout_s))
    except RayError:
        return ""


def _why(answer: Any) -> str:
    """How a call ended, in a line."""
    try:
        ray.get(answer, timeout=STOP_S)
    except RayError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        return lines[-1] if lines else type(error).__name__
    return "it returned"
