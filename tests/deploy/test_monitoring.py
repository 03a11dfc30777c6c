"""The dashboard and the rules agree with the metrics that the code defines."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from grafana_foundation_sdk.cog.encoder import JSONEncoder

from deploy import dashboard
from giirl_core.metrics import Metrics
from tests.end_to_end.commands import ROOT

RULES, RULES_TEST = ROOT / "deploy/rules.yml", ROOT / "deploy/rules_test.yml"


def rules() -> list[dict[str, Any]]:
    return [rule for group in yaml.safe_load(RULES.read_text())["groups"] for rule in group["rules"]]


def promtool(*arguments: str) -> tuple[int, str]:
    program = shutil.which("promtool")
    if program is None:
        pytest.skip("promtool is not on PATH: apt-get install prometheus")
    done = subprocess.run([program, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, done.stdout + done.stderr


def samples() -> Iterator[tuple[str, set[str]]]:
    """The name of every series, and the names of its labels."""
    for metric in vars(Metrics()).values():
        if hasattr(metric, "_labelnames"):
            suffixes = {"counter": ("_total",), "histogram": ("_bucket", "_sum", "_count")}.get(metric._type, ("",))
            for suffix in suffixes:
                yield metric._name + suffix, {*metric._labelnames, *(["le"] if suffix == "_bucket" else [])}


def test_the_committed_dashboard_is_the_generated_one() -> None:
    generated = JSONEncoder(sort_keys=True, indent=2).encode(dashboard.build().build()) + "\n"
    assert (ROOT / "deploy/grafana.json").read_text() == generated


def test_every_metric_of_the_code_is_on_the_dashboard() -> None:
    text = (ROOT / "deploy/grafana.json").read_text()
    families = {family.name for family in Metrics().registry.collect() if family.name.startswith("giirl_")}
    assert {name for name in families if not re.search(rf"\b{name}(_total|_bucket|_sum)?\b", text)} == set()


def test_a_panel_cannot_ask_for_a_label_or_a_series_that_does_not_exist() -> None:
    with pytest.raises(KeyError, match="giirl_trajectories_dropped has no label 'cause'"):
        dashboard.rate(dashboard.M.trajectories_dropped, cause="stale")
    with pytest.raises(KeyError, match="process_threads"):
        dashboard.process("process_threads", "process")


def test_promtool_accepts_the_rules_and_the_settings_of_prometheus() -> None:
    assert promtool("check", "rules", "deploy/rules.yml")[0] == 0
    status, output = promtool("check", "config", "deploy/prometheus.yml")
    assert status == 0, output


def test_the_rules_pass_their_tests() -> None:
    status, output = promtool("test", "rules", "deploy/rules_test.yml")
    assert status == 0, output


def test_every_alert_has_a_case_in_which_it_fires_and_one_in_which_it_does_not() -> None:
    alerts = {rule["alert"] for rule in rules() if "alert" in rule}
    healthy, faulty, _ = yaml.safe_load(RULES_TEST.read_text())["tests"]
    assert {case["alertname"] for case in healthy["alert_rule_test"]} == alerts
    firing = " ".join(sample["labels"] for sample in faulty["promql_expr_test"][0]["exp_samples"])
    assert set(re.findall(r'alertname="(\w+)"', firing)) == alerts


def test_the_rules_name_series_and_labels_that_exist() -> None:
    known = {**dict(samples()), **{rule["record"]: set[str]() for rule in rules() if "record" in rule}}
    target = {"job", "run", "process", "node"}  # labels that Prometheus adds
    for rule in rules():
        for name, labels in re.findall(r"\b((?:run:)?giirl_\w+(?::\w+)?)(?:\{([^}]*)\})?", rule["expr"]):
            assert name in known, rule
            assert set(re.findall(r"(\w+)=", labels)) <= known[name] | target, rule


def test_every_alert_says_what_to_do() -> None:
    for rule in rules():
        if "alert" in rule:
            assert set(rule["annotations"]) == {"summary", "description"}
            assert rule["labels"]["severity"] in ("critical", "warning", "info")
