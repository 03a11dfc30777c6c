"""Metrics as a Prometheus server scrapes them over HTTP."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from giirl_core.metrics import Metrics, waiting, write_targets

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def metrics() -> Iterator[Metrics]:
    with closing(Metrics()) as made:
        yield made


def scrape(address: str) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    no_proxy = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with no_proxy.open(f"http://{address}/metrics", timeout=10) as response:
        families = list(text_string_to_metric_families(response.read().decode()))
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in families
        for sample in family.samples
    }


def test_a_scrape_returns_the_recorded_values(metrics: Metrics) -> None:
    address = metrics.serve()
    metrics.env_steps.inc(3)
    metrics.episodes.labels("click-test", "success").inc()
    metrics.trajectories_dropped.labels("stale").inc(2)
    metrics.policy_version.set(7)
    metrics.policy_lag.observe(2)
    metrics.gradient_update_duration.labels("policy").observe(0.03)
    found = scrape(address)
    assert found["giirl_env_steps_total", frozenset()] == 3
    labels = frozenset({("task", "click-test"), ("outcome", "success")})
    assert found["giirl_episodes_total", labels] == 1
    assert found["giirl_trajectories_dropped_total", frozenset({("reason", "stale")})] == 2
    assert found["giirl_policy_version", frozenset()] == 7
    assert found["giirl_policy_lag_versions_bucket", frozenset({("le", "1.0")})] == 0
    assert found["giirl_policy_lag_versions_bucket", frozenset({("le", "2.0")})] == 1
    assert found["giirl_gradient_update_duration_seconds_count", frozenset({("network", "policy")})] == 1


IN_ANOTHER_SERVICE = """
from prometheus_client import CollectorRegistry, Counter
from giirl_core.metrics import Metrics
metrics = Metrics()
metrics.episodes.labels("click-test", "success").inc()
metrics.policy_lag.observe(1)
print(metrics.registry.get_sample_value("giirl_episodes_total", {"task": "click-test", "outcome": "success"}))
Counter("own", "a counter of the service", registry=CollectorRegistry()).inc()
"""


def test_the_folder_of_another_services_metrics_is_left_to_it(tmp_path: Path) -> None:
    def start() -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PROMETHEUS_MULTIPROC_DIR": str(tmp_path / "prom"), "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", IN_ANOTHER_SERVICE]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=False)

    without_folder = start()
    assert without_folder.stdout == "1.0\n", without_folder.stderr
    assert "prom/counter_" in without_folder.stderr  # the service's own counter, as the service has asked for
    (tmp_path / "prom").mkdir()
    assert start().returncode == 0
    (file,) = (tmp_path / "prom").iterdir()
    assert b"giirl" not in file.read_bytes()


def test_the_names_of_all_metrics(metrics: Metrics) -> None:
    assert {family.name for family in metrics.registry.collect()} == {
        "giirl_browser_recoveries",
        "giirl_connections_refused",
        "giirl_discriminator_accuracy_ratio",
        "giirl_env_steps",
        "giirl_episodes",
        "giirl_episodes_unscored",
        "giirl_gradient_update_duration_seconds",
        "giirl_gradient_updates",
        "giirl_healthy_workers",
        "giirl_page_limits",
        "giirl_policy_lag_versions",
        "giirl_policy_version",
        "giirl_reward_lag_versions",
        "giirl_reward_version",
        "giirl_scoring_duration_seconds",
        "giirl_scoring_requests",
        "giirl_trajectories_dropped",
        "giirl_trajectories_received",
        "giirl_rewards_used",
        "giirl_waiting_seconds",
        "giirl_waiting_threads",
        "giirl_weights_refused",
        "giirl_worker_exits",
    }


def test_the_help_of_every_metric_is_a_sentence(metrics: Metrics) -> None:
    texts = [family.documentation for family in metrics.registry.collect()]
    assert [text for text in texts if not (text[0].isupper() and text.endswith("."))] == []


def test_two_instances_share_no_state(metrics: Metrics) -> None:
    metrics.env_steps.inc()
    with closing(Metrics()) as other:
        assert scrape(other.serve())["giirl_env_steps_total", frozenset()] == 0


def test_a_wait_is_visible_while_it_lasts_and_its_time_counts_even_when_it_raises(metrics: Metrics) -> None:
    def value(name: str) -> float | None:
        return metrics.registry.get_sample_value(name, {"reason": "rollouts"})

    def fail_while_waiting() -> None:
        with waiting(metrics, "rollouts"):
            assert value("giirl_waiting_threads") == 1
            raise TimeoutError

    with pytest.raises(TimeoutError):
        fail_while_waiting()
    assert value("giirl_waiting_threads") == 0
    assert (value("giirl_waiting_seconds_total") or 0) > 0


def test_a_port_in_use_is_reported_in_one_line(metrics: Metrics) -> None:
    port = int(metrics.serve().rpartition(":")[2])
    with pytest.raises(ValueError, match=rf"metrics cannot listen on 127\.0\.0\.1:{port}: ") as caught:
        metrics.serve(port=port)
    assert "\n" not in str(caught.value)


def test_the_service_discovery_file_lists_every_process(tmp_path: Path) -> None:
    path = tmp_path / "targets.json"
    write_targets(path, "one", {"learner": "127.0.0.1:1"})
    write_targets(path, "one", {"learner": "127.0.0.1:2", "actor-0": "127.0.0.1:3"})
    assert json.loads(path.read_text()) == [
        {"targets": ["127.0.0.1:3"], "labels": {"job": "giirl", "run": "one", "process": "actor-0"}},
        {"targets": ["127.0.0.1:2"], "labels": {"job": "giirl", "run": "one", "process": "learner"}},
    ]
    assert list(tmp_path.iterdir()) == [path]
