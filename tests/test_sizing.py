"""docs/scaling.md has the numbers that follow from the measured costs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.scale.sizing import RESULTS, WORKLOADS, browsers_of_a_learner, costs, need, tables

ROOT = Path(__file__).parent.parent


def test_the_tables_of_the_scaling_page_are_the_computed_ones() -> None:
    assert "\n".join(tables()) in (ROOT / "docs/scaling.md").read_text()


@pytest.mark.parametrize("workload", ["four", "mix"])
def test_the_costs_add_up_to_the_processor_time_that_was_measured(workload: str) -> None:
    row = json.loads((RESULTS / "training.json").read_text())[workload]
    cost = costs(workload)
    total_ms = (cost.actor + cost.learner + cost.reward_service) * row["episodes_per_s"]
    assert total_ms == pytest.approx(2000 * (1 - row["cpu_share"]["other"]), rel=0.01)


def test_a_browser_never_takes_more_than_a_core_and_slow_pages_take_less() -> None:
    for workload, step_s in WORKLOADS.values():
        assert need(workload, step_s, 1).actor_cores <= 1 + 1e-9
    assert need("mix", 1.0, 100).actor_cores < need("mix", 0.0, 100).actor_cores / 10
    assert browsers_of_a_learner("mix", 1.0) > browsers_of_a_learner("mix", 0.0)
