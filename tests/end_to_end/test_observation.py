"""What an operator sees of a run: every panel and rule has data, warnings come once, dead runs leave no addresses."""

from __future__ import annotations

import json
import re
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field

import pytest
import yaml

from tests.end_to_end.commands import LOOPBACK, ROOT, Command, run_folder, step, targets
from tests.end_to_end.prometheus import PrometheusQuery, prometheus

pytestmark = [pytest.mark.ray, pytest.mark.timeout(400)]

DASHBOARD, RULES = ROOT / "deploy/grafana.json", ROOT / "deploy/rules.yml"
PROCESSES = ("learner", "actor-0", "actor-1", "reward-service-0")
SMALL = (
    "train",
    "runtime=local",
    "browser=fake",
    "tasks=" + json.dumps(["click-test-2"]),
    "rollout_batch=8",
    "checkpoint_every=5",
    "net.vectors=hashed",
    "demos.per_task=8",
    "evaluate.episodes=4",
    "evaluate.random_episodes=4",
)


def expressions() -> dict[str, str]:
    """Every query of the dashboard by its panel and letter."""
    panels = json.loads(DASHBOARD.read_text())["panels"]
    return {f"{p['title']} {t['refId']}": t["expr"] for p in panels for t in p.get("targets", ())}


def recorded() -> list[str]:
    """The names of the recording rules."""
    groups = yaml.safe_load(RULES.read_text())["groups"]
    return [rule["record"] for group in groups for rule in group["rules"] if "record" in rule]


@dataclass(slots=True, kw_only=True)
class Observed:
    """What was seen of a run that was killed, and of the next one in the same folder of runs."""

    identity: str = ""
    addresses: dict[str, str] = field(default_factory=dict)  # as announced
    up: dict[str, float] | None = None  # process -> `up`, from Prometheus over HTTP discovery; None without Prometheus
    labels: list[set[str]] = field(default_factory=list)  # of the series `up`
    empty: list[str] = field(default_factory=list)  # queries without data
    firing: list[str] = field(default_factory=list)  # alerts
    ready: dict[str, int] = field(default_factory=dict)  # process -> status of /readyz
    after_kill: dict[str, str] = field(default_factory=dict)  # addresses that the dead run left
    after_next: dict[str, str] = field(default_factory=dict)  # the same when another run has begun


@pytest.fixture(scope="module")
def observed() -> Iterator[Observed]:
    with run_folder() as run, ExitStack() as sockets:
        free = [sockets.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(2)]
        port, worker_port = (server.getsockname()[1] for server in free)
        sockets.close()
        ports = ("metrics.host=0.0.0.0", f"metrics.port={port}", f"metrics.worker_port={worker_port}")
        found = Observed()
        with Command(*SMALL, *ports, "iterations=100000", "actors.count=2", f"run={run}") as command:
            command.until(lambda: step(run) > 6 and set(targets(run)) == set(PROCESSES), "a run under way")
            found.identity, found.addresses = (run / "identity").read_text(), targets(run)
            discovery = f"http_sd_configs: [{{url: 'http://127.0.0.1:{port}/targets', refresh_interval: 1s}}]"
            with prometheus(run.parent, discovery, RULES) as query:
                if query:
                    _observe(command, query, found)
            found.ready = {process: _status(f"http://{found.addresses[process]}/readyz") for process in PROCESSES}
            command.stop(signal.SIGKILL)
            command.wait()
            found.after_kill = targets(run)
        with Command(*SMALL, "iterations=2", f"run={run.parent / 'next'}") as command:
            assert command.wait() == 0, command.err
        found.after_next = targets(run)
        yield found


def _observe(command: Command, query: PrometheusQuery, found: Observed) -> None:
    """Wait until every process is scraped and every query has data, and note what has none after that time."""

    def complete() -> bool:
        rows = query("up")
        found.up = {row["metric"]["process"]: float(row["value"][1]) for row in rows}
        found.labels = [set(row["metric"]) for row in rows]
        queries = {**expressions(), **{name: name for name in recorded()}}
        found.empty = [name for name, text in queries.items() if not query(_filled(text, found.identity))]
        return set(found.up.values()) == {1.0} and len(found.up) == len(PROCESSES) and not found.empty

    try:
        command.until(complete, "data in every query", timeout_s=60)
    except AssertionError:
        assert command.process.poll() is None, command.err
    found.firing = [row["metric"]["alertname"] for row in query('ALERTS{alertstate="firing"}')]


def _filled(expression: str, run: str) -> str:
    return expression.replace("$__rate_interval", "20s").replace("$run", run)


def _status(url: str) -> int:
    with LOOPBACK.open(url, timeout=5) as response:
        return int(response.status)


def needs_prometheus(observed: Observed) -> None:
    if observed.up is None:
        pytest.skip("prometheus is not on PATH: apt-get install prometheus")


def test_prometheus_finds_every_process_over_http_with_run_process_and_node(observed: Observed) -> None:
    needs_prometheus(observed)
    assert observed.up == dict.fromkeys(PROCESSES, 1.0)
    assert all({"job", "run", "process", "node"} <= labels for labels in observed.labels)


def test_no_panel_of_the_dashboard_and_no_recording_rule_is_without_data(observed: Observed) -> None:
    needs_prometheus(observed)
    assert observed.empty == []


def test_a_healthy_run_raises_no_alert(observed: Observed) -> None:
    needs_prometheus(observed)
    assert observed.firing == []


def test_processes_that_listen_on_all_addresses_are_announced_under_one_that_other_nodes_reach(
    observed: Observed,
) -> None:
    hosts = {address.rpartition(":")[0] for address in observed.addresses.values()}
    assert len(hosts) == 1
    assert "0.0.0.0" not in hosts
    ports = sorted(int(address.rpartition(":")[2]) for name, address in observed.addresses.items() if name != "learner")
    assert ports[-1] - ports[0] < 10  # one after the other from metrics.worker_port on


def test_every_process_of_a_run_under_way_is_ready(observed: Observed) -> None:
    assert observed.ready == dict.fromkeys(PROCESSES, 200)


def test_the_addresses_of_a_run_that_was_killed_are_removed_by_the_next_run(observed: Observed) -> None:
    assert set(observed.after_kill) == set(PROCESSES)
    assert observed.after_next == {}


def test_a_warning_of_many_workers_reaches_the_log_of_the_run_once() -> None:
    with Command("4", program=[sys.executable, "-m", "tests.end_to_end.warn"]) as command:
        assert command.wait() == 0, command.err
        lines = [line for line in command.output.splitlines() if "rejected policy weights" in line]
    pattern = r"\(WarningProcess pid=\d+\) \d{4}-\S+Z WARNING run actor-\d: rejected policy weights: .*"
    assert re.fullmatch(pattern, lines[0])
    assert len(lines) == 2, lines  # the second says how often the first came again
    assert "[repeated 3x across cluster]" in lines[1]
