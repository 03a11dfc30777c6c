"""A run in real processes: its result, its metrics, and the faults that it survives."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from tests.end_to_end.commands import curve, read_json, run_giirl, step, total
from tests.end_to_end.survival import ITERATIONS, TASKS, Survival

pytestmark = [pytest.mark.chrome, pytest.mark.ray, pytest.mark.timeout(600)]

METRICS = {
    "actor-0": {
        "giirl_env_steps_total",
        "giirl_episodes_total",
        "giirl_policy_version",
        "giirl_waiting_seconds_total",
    },
    "learner": {
        "giirl_trajectories_received_total",
        "giirl_trajectories_taken_total",
        "giirl_training_statistic",
        "giirl_run_info",
        "giirl_actor_last_heard_timestamp_seconds",
        "process_resident_memory_bytes",
        "giirl_policy_version",
        "giirl_reward_version",
        "giirl_policy_lag_versions_count",
        "giirl_reward_lag_versions_count",
        "giirl_gradient_updates_total",
        "giirl_gradient_update_duration_seconds_count",
        "giirl_rewards_used_total",
        "giirl_discriminator_accuracy_ratio",
        "giirl_waiting_seconds_total",
    },
    "reward-service-0": {
        "giirl_reward_version",
        "giirl_scoring_requests_total",
        "giirl_scoring_duration_seconds_count",
        "giirl_waiting_seconds_total",
    },
}


def test_a_run_that_lost_browser_actor_and_reward_service_completes(survival: Survival) -> None:
    assert survival.status == 0, survival.output
    assert step(survival.run) == ITERATIONS
    assert survival.leftover == []


def test_the_result_has_success_rates_with_intervals_and_the_random_baseline(survival: Survival) -> None:
    result = read_json(survival.run / "result.json")
    assert result["env_steps"] == curve(survival.run)[-1]["env_steps"] > 0
    assert result["seconds"] > 0
    assert set(result["tasks"]) == set(TASKS)
    for row in result["tasks"].values():
        assert row["episodes"] == row["random_episodes"] == 20
        assert 0 <= row["low"] <= row["success"] <= row["high"] <= 1
        assert 0 <= row["random"] <= 1


def test_a_run_prints_its_result_as_a_table(survival: Survival) -> None:
    for task, row in read_json(survival.run / "result.json")["tasks"].items():
        line = next(line for line in survival.output.splitlines() if "│" in line and f" {task} " in line)
        assert f" {100 * row['success']:.1f} " in line
        assert f" {100 * row['random']:.1f} " in line


@pytest.mark.parametrize("process", sorted(METRICS))
def test_every_process_of_a_run_serves_its_metrics(survival: Survival, process: str) -> None:
    sample = survival.healthy[process]
    assert METRICS[process] - {name for name, _ in sample} == set()
    assert [name for name in METRICS[process] if name.endswith("_total") and total(sample, name) == 0] == []


def test_metrics_have_the_documented_labels(survival: Survival) -> None:
    learner = survival.learner
    for task in TASKS:
        assert total(survival.healthy["actor-0"], "giirl_episodes_total", task=task, purpose="train") > 0
        assert total(learner, "giirl_episodes_total", task=task, purpose="train") == 0
        assert total(learner, "giirl_episodes_total", task=task, purpose="demonstrate") >= 20
    for network in ("policy", "reward"):
        assert total(learner, "giirl_gradient_updates_total", network=network) > 0, network
    accuracy = {dict(labels)["source"]: v for (name, labels), v in learner.items() if name.endswith("_accuracy_ratio")}
    assert {"expert", "rollouts"} <= set(accuracy)
    assert all(0 <= value <= 1 for value in accuracy.values())
    assert total(learner, "giirl_waiting_seconds_total", reason="rollouts") > 0
    assert total(learner, "giirl_run_phase", phase="training") == 1
    assert total(learner, "giirl_workers", kind="actor", state="running") == 1
    assert total(learner, "giirl_iterations_goal") == ITERATIONS
    assert total(learner, "giirl_checkpoint_timestamp_seconds") > time.time() - 3600
    assert total(learner, "giirl_policy_lag_versions_count") > 0
    assert total(learner, "giirl_reward_lag_versions_count") > 0


def test_the_update_uses_rewards_from_the_service(survival: Survival) -> None:
    assert total(survival.learner, "giirl_rewards_used_total", source="service") > 0


def test_prometheus_finds_every_process_in_the_file_that_the_run_writes(survival: Survival) -> None:
    if survival.up is None:
        pytest.skip("prometheus is not on PATH: apt-get install prometheus")
    assert survival.up == {"learner": 1.0, "actor-0": 1.0, "reward-service-0": 1.0}
    assert survival.prometheus_env_steps > 0


def test_an_actor_whose_chrome_was_killed_goes_on_in_a_new_one(survival: Survival) -> None:
    assert total(survival.after_chrome, "giirl_browser_recoveries_total", cause="browser_died") == survival.chrome_kills
    assert total(survival.after_chrome, "giirl_episodes_total", outcome="lost") > 0
    assert total(survival.after_chrome, "giirl_episodes_total", outcome="success") > 0


def test_a_killed_actor_is_replaced_by_a_new_process_that_plays(survival: Survival) -> None:
    first, second = survival.actors
    assert first != second
    assert total(survival.after_actor, "giirl_env_steps_total") > 0


def test_the_new_actor_has_a_later_incarnation_in_the_checkpoint(survival: Survival) -> None:
    before, after = survival.incarnations
    assert after > before


def test_a_killed_reward_service_is_replaced_by_one_that_replies(survival: Survival) -> None:
    first, second = survival.services
    assert first != second
    assert total(survival.after_service, "giirl_scoring_requests_total", result="ok") > 0
    assert total(survival.after_service, "giirl_reward_version") > 0


def test_evaluating_a_run_writes_the_same_fields_as_its_result(survival: Survival, tmp_path: Path) -> None:
    out = tmp_path / "evaluated.json"
    status, output, leftover = run_giirl(
        "evaluate", survival.run, "evaluate.episodes=10", "evaluate.random_episodes=10", "--json", out
    )
    assert (status, leftover) == (0, []), output
    evaluated, result = read_json(out), read_json(survival.run / "result.json")
    assert {"tasks", "env_steps", "seconds"} <= set(evaluated)
    assert evaluated["env_steps"] == result["env_steps"]
    assert set(evaluated["tasks"]) == set(TASKS)
    for task, row in evaluated["tasks"].items():
        assert set(row) == set(result["tasks"][task])
        assert row["episodes"] == 10


def test_goal_swap_writes_how_often_the_reward_follows_the_goal(survival: Survival, tmp_path: Path) -> None:
    out = tmp_path / "goal_swap.json"
    status, output, leftover = run_giirl(
        "reward", "goal-swap", survival.run, "--task", "click-button", "--pages", "20", "--json", out
    )
    assert (status, leftover) == (0, []), output
    result = read_json(out)
    assert (result["task"], result["pages"]) == ("click-button", 20)
    for rate in (result["own_goal_top1"], result["swapped_goal_top1"]):
        assert 0 <= rate <= 1
