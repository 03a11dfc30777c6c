"""What the system counts about itself, under the names that dashboards and alerts know."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from wsgiref.simple_server import WSGIServer

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server

from giirl_core.files import write_json

LAGS = (0, 1, 2, 3, 4, 6, 8, 12, 16)  # versions
SECONDS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)


class Metrics:
    """Every metric of the system, in a registry of its own: two instances never share a number."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._servers: list[tuple[WSGIServer, Thread]] = []

        self.env_steps = self._counter("giirl_env_steps_total", "Actions carried out by environments")
        self.episodes = self._counter("giirl_episodes_total", "Episodes that ended", "task", "outcome")
        self.browser_restarts = self._counter("giirl_browser_restarts_total", "Browsers started anew", "cause")

        self.trajectories_received = self._counter(
            "giirl_trajectories_received_total",
            "Trajectory messages that reached the learner, whatever became of them",
        )
        self.trajectories_dropped = self._counter(
            "giirl_trajectories_dropped_total", "Trajectories the learner did not train on", "reason"
        )
        self.policy_version = self._gauge("giirl_policy_version", "Learner step of the policy in use")
        self.reward_version = self._gauge("giirl_reward_version", "Learner step of the reward in use")
        self.policy_lag = self._histogram("giirl_policy_lag", "Versions a trajectory's policy is behind", LAGS)
        self.reward_lag = self._histogram("giirl_reward_lag", "Versions a trajectory's reward is behind", LAGS)

        self.connections_refused = self._counter(
            "giirl_connections_refused_total",
            "Connections turned away, as with a wrong key or none",
            "socket",
        )
        self.weights_refused = self._counter(
            "giirl_weights_refused_total", "Weights that were corrupt, older or unfit", "network"
        )

        self.updates = self._counter("giirl_updates_total", "Gradient updates", "network")
        self.update_seconds = self._histogram("giirl_update_seconds", "Time of one update", SECONDS, "network")
        self.rewards_used = self._counter(
            "giirl_rewards_used_total", "Trajectories trained on, by who computed their rewards", "source"
        )
        self.discriminator_accuracy = self._gauge(
            "giirl_discriminator_accuracy", "Share of samples the discriminator gets right", "source"
        )

        self.scoring_requests = self._counter(
            "giirl_scoring_requests_total", "Requests for rewards, by how they were answered", "result"
        )
        self.scoring_seconds = self._histogram(
            "giirl_scoring_seconds", "Time from a request's arrival to its answer", SECONDS
        )

        self.scoring_given_up = self._counter(
            "giirl_scoring_given_up_total", "Episodes sent on unscored, since the reward service did not answer"
        )

        self.workers = self._gauge("giirl_workers", "Processes that are not given up", "kind")
        self.worker_restarts = self._counter("giirl_worker_restarts_total", "Processes that ended or hung", "kind")

        self.waiting_seconds = self._counter("giirl_waiting_seconds_total", "Time spent waiting", "what")
        self.waiting_now = self._gauge("giirl_waiting_now", "Threads that wait at this moment", "what")

    def serve(self, host: str = "127.0.0.1", port: int = 0) -> str:
        """Answer scrapes over HTTP until `close`; port 0 picks a free one. Returns "host:port"."""
        try:
            server, thread = start_http_server(port, host, self.registry)
        except (OSError, OverflowError) as error:
            raise ValueError(f"metrics cannot listen on {host}:{port}: {error}; wanted a free port, or 0") from error
        self._servers.append((server, thread))
        return f"{host}:{server.server_port}"

    def close(self) -> None:
        """Stop answering."""
        while self._servers:
            server, thread = self._servers.pop()
            server.shutdown()
            server.server_close()
            thread.join(timeout=5)

    def _counter(self, name: str, text: str, *labels: str) -> Counter:
        return Counter(name, text, labels, registry=self.registry)

    def _gauge(self, name: str, text: str, *labels: str) -> Gauge:
        return Gauge(name, text, labels, registry=self.registry)

    def _histogram(self, name: str, text: str, buckets: tuple[float, ...], *labels: str) -> Histogram:
        return Histogram(name, text, labels, buckets=buckets, registry=self.registry)


@contextmanager
def timed_update(metrics: Metrics, network: str) -> Iterator[None]:
    """Count this block as one gradient update of `network`, with its time."""
    with metrics.update_seconds.labels(network).time():
        yield
    metrics.updates.labels(network).inc()


@contextmanager
def waiting(metrics: Metrics, what: str) -> Iterator[None]:
    """Count the time of this block as waiting, and show it while it lasts."""
    since_s = time.monotonic()
    metrics.waiting_now.labels(what).inc()
    try:
        yield
    finally:
        metrics.waiting_now.labels(what).dec()
        metrics.waiting_seconds.labels(what).inc(time.monotonic() - since_s)


def write_targets(path: Path, run: str, targets: Mapping[str, str]) -> None:
    """Tell Prometheus (file_sd) where to scrape a run: process -> "host:port"."""
    groups = [
        {"targets": [address], "labels": {"job": "giirl", "run": run, "process": process}}
        for process, address in sorted(targets.items())
    ]
    write_json(path, groups)
