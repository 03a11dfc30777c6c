"""The metrics of a process, how it serves them and its state over HTTP, and timers that update them."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from giirl_core.telemetry.health import Health
from giirl_core.telemetry.series import PHASES, Series
from giirl_core.telemetry.server import Endpoints, TelemetryServer
from giirl_core.telemetry.targets import join_port, target_groups


class Metrics(Series):
    """All metrics of one process, its health, and its HTTP servers."""

    def __init__(self, kind: str = "") -> None:
        super().__init__(kind)
        self.health = Health()
        self._targets: list[dict[str, Any]] = []
        self._servers: list[TelemetryServer] = []

    def serve(self, host: str = "127.0.0.1", port: int = 0, *, ports: int = 1) -> str:
        """Serve metrics and state over HTTP until `close`; returns "host:port".

        Listens on the first free one of `ports` ports from `port` on; port 0 picks any free one. Raises ValueError when
        no port can be bound.
        """
        endpoints = Endpoints(
            metrics=self.render, health=self.health, targets=lambda: json.dumps(self._targets).encode()
        )
        server = TelemetryServer(host, range(port, min(port + ports, 1 << 16)) if port else range(1), endpoints)
        self._servers.append(server)
        return join_port(host, server.port)

    def close(self) -> None:
        """Stop all HTTP servers."""
        while self._servers:
            self._servers.pop().close()

    def announce(self, run: str, targets: Mapping[str, str]) -> list[dict[str, Any]]:
        """Answer /targets with the addresses of a run's processes; returns them in Prometheus's form."""
        self._targets = target_groups(run, targets)
        return self._targets

    def enter(self, phase: str) -> None:
        """The run is in this phase from now on. It is ready while it trains."""
        assert phase in PHASES
        for name in PHASES:
            self.run_phase.labels(name).set(name == phase)
        if phase == "training":
            self.health.ready()
        else:
            self.health.not_ready(f"the phase of the run is {phase}")

    def dropped(self) -> dict[str, int]:
        """The numbers above 0 of episodes that were dropped, by reason, and of lost ones."""
        families = (*self.trajectories_dropped.collect(), *self.trajectories_lost.collect())
        samples = [sample for family in families for sample in family.samples if sample.value]
        return {sample.labels.get("reason", "lost"): int(sample.value) for sample in samples}

    def begin(self, identity: str, algorithm: str, device: str, version: int, iterations: int) -> None:
        """A session of training begins at iteration `version`, with `iterations` as its goal."""
        self.enter("starting")
        self.run_info.labels(identity, algorithm, device).set(1)
        self.policy_version.set(version)
        self.iterations_goal.set(iterations)

    def end_iteration(
        self, version: int, statistics: Mapping[str, float], flow: Mapping[str, float], device_memory_bytes: int
    ) -> None:
        """An iteration is done: `version` is its number; `statistics` and `flow` are those of curve.jsonl."""
        self.health.beat()
        self.policy_version.set(version)
        self.reward_version.set(version)
        self.device_memory.set(device_memory_bytes)
        for key, value in statistics.items():
            self.training_statistic.labels(key).set(value)
        for key, value in flow.items():
            self.flow.labels(key).set(value)


@contextmanager
def timed_update(metrics: Metrics, network: str) -> Iterator[None]:
    """Measure a block as one gradient update of `network`; one that raises is timed but not counted as completed."""
    with metrics.gradient_update_duration.labels(network).time():
        yield
    metrics.gradient_updates.labels(network).inc()


@contextmanager
def waiting(metrics: Metrics, reason: str) -> Iterator[None]:
    """Measure a block as waiting: its duration, and the number of threads inside it. `reason` is what it waits for."""
    start_s = time.monotonic()
    metrics.waiting_threads.labels(reason).inc()
    try:
        yield
    finally:
        metrics.waiting_threads.labels(reason).dec()
        metrics.waiting_seconds.labels(reason).inc(time.monotonic() - start_s)
