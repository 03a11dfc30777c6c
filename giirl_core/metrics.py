"""Every Prometheus metric of the system, the HTTP server that exposes them, and timers that update them.

Names follow the Prometheus conventions: the prefix `giirl_`, the unit as a suffix, `_total` for counters. Labels take
a few fixed values only (a reason, a task), never a seed or an actor: Prometheus adds the label `process` when it
scrapes (see `write_targets`).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Lock, Thread
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server, values

from giirl_core.files import write_json

LAG_BUCKETS = (0, 1, 2, 3, 4, 6, 8, 12, 16)  # versions
DURATION_BUCKETS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # seconds

_VALUE_CLASS_LOCK = Lock()


class _InMemory:
    """Holds the values of a metric in this process.

    The library would put them into the files of PROMETHEUS_MULTIPROC_DIR, which belong to another service.
    """

    def _metric_init(self) -> None:
        with _VALUE_CLASS_LOCK:
            chosen, values.ValueClass = values.ValueClass, values.MutexValue
            try:
                super()._metric_init()  # type: ignore[misc]
            finally:
                values.ValueClass = chosen


class _Counter(_InMemory, Counter):
    pass


class _Gauge(_InMemory, Gauge):
    pass


class _Histogram(_InMemory, Histogram):
    pass


class Metrics:
    """All metrics, in a registry of their own: two instances share no state."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._servers: list[tuple[WSGIServer, Thread]] = []
        self._define_environment()
        self._define_delivery()
        self._define_training()
        self._define_scoring()
        self._define_processes()

    def serve(self, host: str = "127.0.0.1", port: int = 0) -> str:
        """Serve the metrics over HTTP until `close`; port 0 picks a free port. Returns "host:port".

        Raises ValueError when the port cannot be bound.
        """
        try:
            server, thread = start_http_server(port, host, self.registry)
        except (OSError, OverflowError) as error:
            raise ValueError(f"metrics cannot listen on {host}:{port}: {error}; wanted a free port, or 0") from error
        self._servers.append((server, thread))
        return f"{host}:{server.server_port}"

    def close(self) -> None:
        """Stop all HTTP servers."""
        while self._servers:
            server, thread = self._servers.pop()
            server.shutdown()
            server.server_close()
            thread.join(timeout=5)

    def _define_environment(self) -> None:
        self.env_steps = self._counter("giirl_env_steps_total", "Number of environment steps.")
        self.episodes = self._counter("giirl_episodes_total", "Number of episodes that ended.", "task", "outcome")
        self.browser_recoveries = self._counter(
            "giirl_browser_recoveries_total",
            "Number of browser recoveries: one for each broken tab, one for each relaunch of a dead browser.",
            "cause",
        )
        self.page_limits = self._counter(
            "giirl_page_limits_total",
            "Number of elements left out of large pages, and of requests and file inputs refused, on own pages.",
            "what",
        )

    def _define_delivery(self) -> None:
        self.trajectories_received = self._counter(
            "giirl_trajectories_received_total",
            "Number of trajectory messages that the learner received, including those it dropped.",
        )
        self.trajectories_dropped = self._counter(
            "giirl_trajectories_dropped_total",
            "Number of trajectory messages that the learner dropped, and of trajectories that were lost.",
            "reason",
        )
        self.policy_lag = self._histogram(
            "giirl_policy_lag_versions",
            "Number of versions by which a trajectory's policy is older than the learner's policy.",
            LAG_BUCKETS,
        )
        self.reward_lag = self._histogram(
            "giirl_reward_lag_versions",
            "Number of versions by which a trajectory's reward is older than the learner's reward.",
            LAG_BUCKETS,
        )
        self.connections_refused = self._counter(
            "giirl_connections_refused_total",
            "Number of refused socket connections, for example because of a wrong or missing key.",
            "socket",
        )

    def _define_training(self) -> None:
        self.policy_version = self._gauge("giirl_policy_version", "Learner step of the policy weights in use.")
        self.reward_version = self._gauge("giirl_reward_version", "Learner step of the reward weights in use.")
        self.weights_refused = self._counter(
            "giirl_weights_refused_total",
            "Number of weights refused because they are corrupt, older than those in use, or of another net.",
            "network",
        )
        self.gradient_updates = self._counter(
            "giirl_gradient_updates_total", "Number of completed gradient updates.", "network"
        )
        self.gradient_update_duration = self._histogram(
            "giirl_gradient_update_duration_seconds", "Duration of one gradient update.", DURATION_BUCKETS, "network"
        )
        self.rewards_used = self._counter(
            "giirl_rewards_used_total",
            "Number of rewards the policy was trained on, by the process that computed them.",
            "source",
        )
        self.discriminator_accuracy = self._gauge(
            "giirl_discriminator_accuracy_ratio",
            "Fraction of each source's samples that the discriminator classifies correctly, in its last update.",
            "source",
        )

    def _define_scoring(self) -> None:
        self.scoring_requests = self._counter(
            "giirl_scoring_requests_total", "Number of scoring requests, by result.", "result"
        )
        self.scoring_duration = self._histogram(
            "giirl_scoring_duration_seconds",
            "Time from the arrival of a scoring request to its reply.",
            DURATION_BUCKETS,
        )
        self.episodes_unscored = self._counter(
            "giirl_episodes_unscored_total",
            "Number of episodes that an actor sent to the learner without rewards from the reward service.",
        )

    def _define_processes(self) -> None:
        self.healthy_workers = self._gauge(
            "giirl_healthy_workers", "Number of worker processes that are neither quarantined nor stopping.", "kind"
        )
        self.worker_exits = self._counter(
            "giirl_worker_exits_total", "Number of worker processes that exited or were killed as hung.", "kind"
        )
        self.waiting_seconds = self._counter(
            "giirl_waiting_seconds_total", "Time that threads spent waiting.", "reason"
        )
        self.waiting_threads = self._gauge("giirl_waiting_threads", "Number of threads that are waiting.", "reason")

    def _counter(self, name: str, help_text: str, *labels: str) -> Counter:
        return _Counter(name, help_text, labels, registry=self.registry)

    def _gauge(self, name: str, help_text: str, *labels: str) -> Gauge:
        return _Gauge(name, help_text, labels, registry=self.registry)

    def _histogram(self, name: str, help_text: str, buckets: tuple[float, ...], *labels: str) -> Histogram:
        return _Histogram(name, help_text, labels, buckets=buckets, registry=self.registry)


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


def write_targets(path: Path, run: str, targets: Mapping[str, str]) -> None:
    """Write a Prometheus service-discovery file (`file_sd`) for one run; `targets` maps process name to "host:port"."""
    groups = [
        {"targets": [address], "labels": {"job": "giirl", "run": run, "process": process}}
        for process, address in sorted(targets.items())
    ]
    write_json(path, groups)
