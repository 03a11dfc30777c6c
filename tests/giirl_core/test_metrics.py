"""Metrics as a Prometheus server scrapes them over HTTP, and the state of a process as probes read it."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from giirl_core.files import folder_lock
from giirl_core.metrics import Metrics, waiting
from giirl_core.telemetry import health
from giirl_core.telemetry.series import KINDS, PURPOSES
from giirl_core.telemetry.targets import clear_dead_targets, reachable, target_groups, write_targets
from giirl_core.types import Purpose

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def metrics() -> Iterator[Metrics]:
    with closing(Metrics()) as made:
        yield made


def get(address: str, path: str) -> tuple[int, str]:
    """The status and the text of an answer."""
    try:
        no_proxy = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with no_proxy.open(f"http://{address}/{path}", timeout=10) as response:
            return response.status, response.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def scrape(address: str) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    families = text_string_to_metric_families(get(address, "metrics")[1])
    return {
        (sample.name, frozenset(sample.labels.items())): sample.value
        for family in families
        for sample in family.samples
    }


def test_a_scrape_returns_the_recorded_values(metrics: Metrics) -> None:
    address = metrics.serve()
    metrics.env_steps.labels("train").inc(3)
    metrics.episodes.labels("click-test", "success", "train").inc()
    metrics.trajectories_dropped.labels("stale").inc(2)
    metrics.policy_version.set(7)
    metrics.policy_lag.observe(2)
    metrics.gradient_update_duration.labels("policy").observe(0.03)
    found = scrape(address)
    assert found["giirl_env_steps_total", frozenset({("purpose", "train")})] == 3
    labels = frozenset({("task", "click-test"), ("outcome", "success"), ("purpose", "train")})
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
metrics.episodes.labels("click-test", "success", "train").inc()
metrics.policy_lag.observe(1)
labels = {"task": "click-test", "outcome": "success", "purpose": "train"}
print(metrics.registry.get_sample_value("giirl_episodes_total", labels))
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
    assert {family.name for family in metrics.registry.collect() if family.name.startswith("giirl_")} == {
        "giirl_actor_last_heard_timestamp_seconds",
        "giirl_browser_recoveries",
        "giirl_build_info",
        "giirl_checkpoint_duration_seconds",
        "giirl_checkpoint_timestamp_seconds",
        "giirl_connections_refused",
        "giirl_device_memory_bytes",
        "giirl_discriminator_accuracy_ratio",
        "giirl_env_steps",
        "giirl_episodes",
        "giirl_episodes_unscored",
        "giirl_flow",
        "giirl_gradient_update_duration_seconds",
        "giirl_gradient_updates",
        "giirl_iterations_goal",
        "giirl_page_limits",
        "giirl_policy_lag_versions",
        "giirl_policy_version",
        "giirl_reward_lag_versions",
        "giirl_reward_version",
        "giirl_rewards_used",
        "giirl_run_info",
        "giirl_run_phase",
        "giirl_scoring_duration_seconds",
        "giirl_scoring_requests",
        "giirl_success_ratio",
        "giirl_training_statistic",
        "giirl_trajectories_dropped",
        "giirl_trajectories_lost",
        "giirl_trajectories_queued",
        "giirl_trajectories_received",
        "giirl_trajectories_rejected",
        "giirl_trajectories_taken",
        "giirl_waiting_seconds",
        "giirl_waiting_threads",
        "giirl_weights_refused",
        "giirl_worker_exits",
        "giirl_workers",
    }


@pytest.mark.parametrize("kind", KINDS)
def test_promtool_finds_nothing_wrong_with_the_metrics_of_any_kind_of_process(kind: str) -> None:
    if not (promtool := shutil.which("promtool")):
        pytest.skip("promtool is not on PATH: apt-get install prometheus")
    with closing(Metrics(kind)) as metrics:
        metrics.episodes.labels("click-test", "success", "train").inc()
        metrics.success.labels("click-test").set(1)
        metrics.begin("one", "giirl", "cpu", 0, 3)
        text = metrics.render("")[0]
    found = subprocess.run([promtool, "check", "metrics"], input=text, capture_output=True, timeout=60, check=False)
    assert (found.returncode, found.stdout, found.stderr) == (0, b"", b"")


def test_a_process_serves_only_the_metrics_of_its_kind() -> None:
    with closing(Metrics("actor")) as actor, closing(Metrics("reward-service")) as service:
        actor.trajectories_lost.inc()  # does nothing that is seen
        names = [{family.name for family in one.registry.collect()} for one in (actor, service)]
    both = {"giirl_build_info", "giirl_waiting_seconds", "giirl_waiting_threads", "giirl_weights_refused"}
    assert {name for name in names[0] & names[1] if name.startswith("giirl_")} == both
    assert "giirl_episodes" in names[0] - names[1]
    assert "giirl_scoring_requests" in names[1] - names[0]


def test_series_whose_labels_have_known_values_exist_from_the_start(metrics: Metrics) -> None:
    found = scrape(metrics.serve())
    assert found["giirl_trajectories_dropped_total", frozenset({("reason", "stale")})] == 0
    assert found["giirl_workers", frozenset({("kind", "actor"), ("state", "given_up")})] == 0


def test_the_purposes_of_episodes_are_those_of_the_code() -> None:
    assert {purpose.name.lower() for purpose in Purpose} == set(PURPOSES)


def test_every_process_shows_its_memory_and_its_open_files(metrics: Metrics) -> None:
    found = scrape(metrics.serve())
    assert found["process_resident_memory_bytes", frozenset()] > 0
    assert 0 < found["process_open_fds", frozenset()] < found["process_max_fds", frozenset()]


def test_the_help_of_every_metric_is_a_sentence(metrics: Metrics) -> None:
    texts = [f.documentation for f in metrics.registry.collect() if f.name.startswith("giirl_")]
    assert [text for text in texts if not (text[0].isupper() and text.endswith("."))] == []


def test_two_instances_share_no_state(metrics: Metrics) -> None:
    metrics.trajectories_lost.inc()
    with closing(Metrics()) as other:
        assert scrape(other.serve())["giirl_trajectories_lost_total", frozenset()] == 0


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


def test_workers_on_one_machine_take_one_port_after_the_other_of_a_fixed_range(metrics: Metrics) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        first = taken.getsockname()[1]
        found = [int(metrics.serve(port=first, ports=20).rpartition(":")[2]) for _ in range(2)]
        assert first < found[0] < found[1] < first + 20
        with pytest.raises(ValueError, match=rf"cannot listen on 127\.0\.0\.1:{first}: "):
            metrics.serve(port=first, ports=1)


def test_metrics_listen_on_ipv6_addresses_too(metrics: Metrics) -> None:
    address = metrics.serve("::1")
    assert address.startswith("[::1]:")
    assert get(address, "healthz") == (200, "ok\n")


def test_a_process_that_listens_on_all_addresses_is_announced_under_that_of_its_node() -> None:
    assert reachable("0.0.0.0:9100", "10.0.0.2") == "10.0.0.2:9100"
    assert reachable("[::]:9100", "fd00::2") == "[fd00::2]:9100"
    assert reachable("127.0.0.1:9100", "10.0.0.2") == "127.0.0.1:9100"


def test_a_process_is_ready_while_it_works(metrics: Metrics) -> None:
    address = metrics.serve()
    assert get(address, "healthz") == (200, "ok\n")
    assert get(address, "readyz") == (503, "it is starting\n")
    metrics.enter("demonstrations")
    assert get(address, "readyz") == (503, "the phase of the run is demonstrations\n")
    metrics.enter("training")
    assert get(address, "readyz") == (200, "ok\n")
    found = scrape(address)
    assert found["giirl_run_phase", frozenset({("phase", "training")})] == 1
    assert found["giirl_run_phase", frozenset({("phase", "demonstrations")})] == 0


def test_a_main_loop_that_stops_moving_is_neither_ready_nor_healthy(
    metrics: Metrics, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = metrics.serve()
    metrics.health.ready()
    metrics.health.beat()
    assert get(address, "healthz")[0] == get(address, "readyz")[0] == 200
    monkeypatch.setattr(health, "HUNG_S", -1.0)
    for path in ("healthz", "readyz"):
        assert get(address, path) == (503, "the main loop has not moved for 0 s, wanted -1\n")
    metrics.health.not_ready("it rests")
    assert get(address, "healthz") == (200, "ok\n")


def test_a_path_that_does_not_exist_is_not_found(metrics: Metrics) -> None:
    assert get(metrics.serve(), "debug")[0] == 404


def test_the_service_discovery_file_and_the_address_for_it_list_every_process(metrics: Metrics, tmp_path: Path) -> None:
    path, address = tmp_path / "targets.json", metrics.serve()
    write_targets(path, metrics.announce("one", {"learner": "127.0.0.1:1"}))
    write_targets(path, metrics.announce("one", {"learner": "10.0.0.1:2", "actor-0": "[fd00::2]:3"}))
    labels = {"job": "giirl", "run": "one"}
    assert json.loads(path.read_text()) == [
        {"targets": ["[fd00::2]:3"], "labels": {**labels, "process": "actor-0", "node": "fd00::2"}},
        {"targets": ["10.0.0.1:2"], "labels": {**labels, "process": "learner", "node": "10.0.0.1"}},
    ]
    assert json.loads(get(address, "targets")[1]) == json.loads(path.read_text())
    assert list(tmp_path.iterdir()) == [path]


def test_the_addresses_of_runs_that_were_killed_are_removed_and_those_of_others_stay(tmp_path: Path) -> None:
    groups = target_groups("one", {"learner": "127.0.0.1:1"})
    for name in ("dead", "alive", "ended", "damaged"):
        (tmp_path / name).mkdir()
        write_targets(tmp_path / name / "prometheus.json", groups if name != "ended" else [])
    (tmp_path / "damaged/prometheus.json").write_text("{")
    with folder_lock(tmp_path / "alive"):
        assert clear_dead_targets(tmp_path) == [tmp_path / "dead"]
    assert json.loads((tmp_path / "dead/prometheus.json").read_text()) == []
    assert json.loads((tmp_path / "alive/prometheus.json").read_text()) == groups
