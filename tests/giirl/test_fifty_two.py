"""The study of fifty-two tasks: its summary, its table, its tasks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from giirl.studies.fifty_two import PUBLISHED, SCRIPTED, TASKS, fifty_two
from giirl.studies.summary import mean_with_interval, summary
from giirl.studies.table import study_table, task_table
from giirl.studies.web import STUDIES
from giirl_core.config import Config
from giirl_core.config_file import load_config
from tests.end_to_end.commands import ROOT


def record(variant: str, seed: int, success: float) -> dict[str, Any]:
    """The record of one run with the same success on 100 pages of every task."""
    row = {"episodes": 100, "success": success, "random": 0.25, "random_episodes": 100}
    reached = {"0.95": dict.fromkeys(TASKS), "0.99": dict.fromkeys(TASKS)}
    return {
        "variant": variant,
        "seed": seed,
        "settings": ["demos.source=recordings"],
        "tasks": dict.fromkeys(TASKS, row),
        "seconds": 10.0 + seed,
        "env_steps": 5,
        "demonstrations": {},
        "episodes_to": reached,
        "env_steps_to": reached,
        "lowest_last_third": {},
    }


def study() -> dict[str, Any]:
    runs = [record("giirl", 0, 0.9), record("giirl", 1, 1.0), record("cloning", 0, 0.5)]
    return summary("fifty-two", runs)


def same_settings(one: Config, other: Config) -> None:
    """All settings but the order of tasks, the demonstrations and the evaluation."""
    others = {name: getattr(other, name) for name in ("tasks", "demos", "evaluate")}
    assert replace(one, **others) == other


def test_the_tasks_are_those_of_the_experiment() -> None:
    config = load_config(ROOT / "experiments/miniwob_fifty_two.toml", [])
    assert sorted(config.tasks) == sorted(TASKS)
    assert sorted(config.demos.scripted_tasks) == sorted(SCRIPTED)
    assert len(TASKS) == 52
    study = STUDIES["fifty-two"]
    same_settings(config, load_config(None, (*study.settings, *study.variants[0].changes)))
    assert sum("wge" in row for row in PUBLISHED.values()) == 48


def test_the_summary_compares_each_task_with_people_and_the_mean_with_cloning() -> None:
    head = fifty_two(study(), "giirl", "cloning")
    assert head["mean"] == head["mean_wge_48"] == 0.95
    assert head["cloning_mean"] == 0.5
    assert head["tasks_at_human"] == sum(row["human"] <= 0.95 for row in PUBLISHED.values())
    assert (head["seeds"], head["seconds"]) == ([0, 1], 11.0)
    row = head["tasks"]["click-color"]
    assert (row["episodes"], row["success"], row["source"]) == (200, 0.95, "scripted")
    assert head["tasks"]["click-link"]["source"] == "recordings"


def test_without_recordings_all_demonstrations_are_scripted() -> None:
    result = study()
    for one in result["runs"]:
        one["settings"] = []
    assert {row["source"] for row in fifty_two(result, "giirl", "cloning")["tasks"].values()} == {"scripted"}


def test_a_task_that_no_browser_could_play_is_in_no_mean() -> None:
    run, cloning = record("giirl", 0, 0.9), record("cloning", 0, 0.5)
    run["tasks"]["click-link"] = {"episodes": 0, "success": None, "random": None, "random_episodes": 0, "missing": 200}
    result = summary("fifty-two", [run, cloning])
    head = fifty_two(result, "giirl", "cloning")
    assert head["mean"] == 0.9
    assert head["tasks"]["click-link"]["missing"] == 200
    assert head["tasks_at_human"] == sum(row["human"] <= 0.9 for row in PUBLISHED.values())
    table = task_table("title", TASKS, result, PUBLISHED)
    assert table.row_count == 53
    assert [*table.columns[-1].cells][-1] == "86.6"  # of HTML-T5


def test_the_interval_of_the_mean_holds_seeds_and_pages() -> None:
    runs = [record("giirl", 0, 0.9), record("giirl", 1, 1.0)]
    low, high = interval(runs)
    assert low == pytest.approx(0.9, abs=0.02)
    assert high == 1.0
    low, high = interval(runs[:1])
    assert low < 0.9 < high < low + 0.03


def interval(records: list[dict[str, Any]]) -> tuple[float, float]:
    found = mean_with_interval(records, TASKS)
    low, high = found["low"], found["high"]
    assert low is not None
    assert high is not None
    return low, high


def test_the_table_has_a_row_for_each_task_and_the_mean() -> None:
    result = study()
    table = study_table("title", result)
    assert table.row_count == 53
    assert [column.header for column in table.columns] == ["task", "giirl", "cloning", "random"]
    assert [next(reversed([*column.cells])) for column in table.columns] == [
        "mean",
        "95.0 (89.6 - 100.0)",
        "50.0 (48.6 - 51.4)",
        "25.0",
    ]


def test_a_variant_that_did_not_play_a_task_has_a_dash_there() -> None:
    result = study()
    del result["variants"]["giirl"]["tasks"]["click-link"]
    row = TASKS.index("click-link")
    cells = [[*column.cells][row] for column in task_table("title", TASKS, result).columns]
    assert cells == ["click-link", "-", "50.0", "25.0"]


def test_a_study_without_any_played_page_has_no_mean() -> None:
    row = {"episodes": 0, "success": None, "random": None, "random_episodes": 0, "missing": 100}
    run = record("giirl", 0, 0.0)
    run["tasks"] = dict.fromkeys(TASKS, row)
    result = summary("fifty-two", [run])
    assert result["variants"]["giirl"]["all_tasks"] == {"mean": None, "low": None, "high": None}
    assert [*study_table("title", result).columns[1].cells][-1] == "- (- - -)"


def test_the_tasks_with_scripted_experts_are_those_of_the_experiment() -> None:
    config = load_config(ROOT / "experiments/miniwob_scripted.toml", [])
    study = STUDIES["scripted-tasks"]
    (run, *_) = (load_config(None, (*study.settings, *variant.changes)) for variant in study.variants)
    assert sorted(config.tasks) == list(run.tasks)
    assert len(run.tasks) == config.rollout_batch == 108
    same_settings(config, run)
