"""Studies: planned from settings, run once, resumed, and summarised."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner

from giirl.cli.reproduce_web import commands
from giirl.figures import _success_at, draw_successes
from giirl.run.folder import RunFolder
from giirl.studies.runner import Variant, evaluate_rewards, measure_transfer, plan, run_all
from giirl.studies.summary import pooled, record, summary
from giirl.studies.table import study_table
from giirl.studies.web import STUDIES, base_settings
from giirl_core.config_file import load_config
from giirl_core.files import write_json
from giirl_core.progress import Display
from giirl_core.telemetry.version import commit
from tests.giirl.small import SETTINGS

VARIANTS = (
    Variant(name="giirl"),
    Variant(name="follower", reward_of="giirl"),
    Variant(name="cloning", changes=("algorithm=cloning", 'tasks=["click-test"]'), transfer_tasks=("click-test-2",)),
)


def test_equal_settings_are_the_same_run_and_a_frozen_reward_is_of_the_same_seed(tmp_path: Path) -> None:
    runs = plan(SETTINGS, VARIANTS, [0, 1], tmp_path)
    again = plan(SETTINGS, VARIANTS, [0, 1], tmp_path)
    assert [run.folder for run in runs] == [run.folder for run in again]
    assert len({run.folder for run in runs}) == 6
    folder = {(run.variant.name, run.seed): run.folder for run in runs}
    for run in runs:
        expected = str(folder["giirl", run.seed]) if run.variant.name == "follower" else ""
        assert run.config.reward_from == expected


@pytest.mark.slow
def test_runs_are_done_once_and_a_failed_one_does_not_stop_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("giirl.studies.runner.GOAL_SWAP_PAGES", 20)
    settings = [*SETTINGS, "iterations=2"]
    broken = Variant(name="broken", changes=("demos.source=file", f"demos.path={tmp_path / 'none'}"))
    orphan = Variant(name="orphan", reward_of="broken")
    runs = plan(settings, (broken, orphan, *VARIANTS), [0], tmp_path / "runs")
    with pytest.raises(RuntimeError, match=r"1 runs failed, the first of them broken, seed 0: giirl: .*none"):
        run_all(runs, jobs=2, display=Display())
    done = {run.variant.name: run for run in runs if run.done}
    assert set(done) == {"giirl", "follower", "cloning"}
    before = {name: RunFolder(run.folder).result.stat().st_mtime_ns for name, run in done.items()}
    run_all(list(done.values()), jobs=2, display=Display())
    assert before == {name: RunFolder(run.folder).result.stat().st_mtime_ns for name, run in done.items()}
    evaluate_rewards(list(done.values()), Display())
    measure_transfer(list(done.values()), Display())
    records = [record(run, evaluates_reward=True) for run in done.values()]
    assert "goal_swap" in records[0]
    assert "goal_swap" not in record(done["giirl"])
    assert [each["algorithm"] for each in records] == ["giirl", "frozen", "cloning"]
    assert records[0]["curve"][-1]["episodes"] == 2 * 8
    result = summary("test", records)
    json.dumps(result)
    assert set(result["variants"]) == set(done)
    assert result["variants"]["cloning"]["tasks"]["click-test-2"]["episodes"] == 4
    answers = result["variants"]["giirl"]
    assert {"own_goal_top1", "swapped_goal_top1"} == set(answers["goal_swap"])
    assert set(answers["sensitivity"]) == {"click-button", "enter-text"}  # where instructions differ
    assert (
        study_table("test", result).row_count == 13
    )  # three for each variant, two for the reward, the random baseline, the thesis


def test_a_finished_run_of_other_code_is_used_again_and_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = plan(SETTINGS, VARIANTS[:1], [0, 1], tmp_path)
    for run, made in zip(runs, (commit(), "abc1234"), strict=True):
        run.folder.mkdir()
        write_json(RunFolder(run.folder).result, {"commit": made})
    run_all(runs, jobs=1, display=Display())
    name, folder = f"{VARIANTS[0].name}, seed 1", runs[1].folder
    assert f"{name} is used again, made by other code (abc1234); delete {folder} to" in capsys.readouterr().err
    run_all(runs[:1], jobs=1, display=Display())
    assert "other code" not in capsys.readouterr().err


def test_a_part_of_a_study_has_the_named_variants_in_the_order_of_the_study() -> None:
    study = STUDIES["frozen"]
    assert study.only(()) == study.variants
    names = ("true reward", "giirl")
    assert [variant.name for variant in study.only(names)] == ["giirl", "true reward"]
    with pytest.raises(ValueError, match=r"variant 'girl': wanted one of 'giirl', 'cloning', "):
        study.only(("girl",))
    with pytest.raises(ValueError, match=r"variant 'fresh policy, frozen reward' .* reward of 'giirl': wanted both"):
        study.only(("fresh policy, frozen reward",))


def test_scripted_tasks_take_no_recordings() -> None:
    study = STUDIES["scripted-tasks"]
    config = load_config(None, [*base_settings(study, Path("recordings")), *study.variants[0].changes])
    assert config.demos.source == "scripted"


def record_of(variant: str, seed: int, successes: list[int]) -> dict[str, Any]:
    """A record of a run on one task, with a short curve."""
    share = sum(successes) / len(successes)
    task = {"episodes": len(successes), "success": share, "low": 0.0, "high": 1.0, "random": 0.1, "random_episodes": 10}
    curve = [
        {"env_steps": 100 * step, "episodes": 10 * step, "success": {"click-it": None if step < 2 else share}}
        for step in range(1, 6)
    ]
    return {"variant": variant, "seed": seed, "tasks": {"click-it": task}, "curve": curve}


def test_a_part_of_a_study_is_marked_and_a_task_without_random_pages_has_a_dash() -> None:
    run = {**record_of("a", 0, [1, 0]), "lowest_last_third": {}, "settings": [], "seconds": 1, "env_steps": 1}
    never: dict[str, dict[str, None]] = {"0.95": {"click-it": None}}
    run |= {"episodes_to": never, "env_steps_to": never, "demonstrations": {}}
    run["tasks"]["click-it"] |= {"random": None, "random_episodes": 0}
    table = study_table("test", summary("test", [run]))
    assert [[*column.cells][-1] for column in table.columns] == ["random", "", "-"]
    whole, part = summary("test", [run]), summary("test", [run], left_out=["b"])
    assert whole["tasks"] == part["variants"]["a"]["tasks"]
    assert "tasks" not in part
    assert part["variants_left_out"] == ["b"]


def test_seeds_are_pooled_with_the_interval_of_all_their_episodes() -> None:
    found = pooled([record_of("a", 0, [1, 1, 1, 0]), record_of("a", 1, [1, 1])])["click-it"]
    assert found["episodes"] == 6
    assert found["success"] == pytest.approx(5 / 6, abs=1e-4)
    assert found["random_episodes"] == 20
    assert found["worst_seed"] == 0.75
    assert found["low"] < found["success"] < found["high"]


def test_a_record_has_the_step_at_which_a_streak_of_episodes_reached_a_level(tmp_path: Path) -> None:
    (run,) = plan(SETTINGS, VARIANTS[:1], [0], tmp_path)
    folder = RunFolder(run.folder)
    run.folder.mkdir(parents=True)
    for step in range(1, 31):
        outcomes = {"click-it": [int(step > 10)] * 5, "press-it": [0] * 5}
        folder.append_curve({"step": step, "env_steps": 20 * step, "episodes": 10 * step, "outcomes": outcomes})
    write_json(folder.result, {"tasks": {}, "seed": 0})
    found = record(run)
    assert found["episodes_to"]["0.95"] == {"click-it": 200, "press-it": None}  # 48 of the last 50, at step 20
    assert found["env_steps_to"]["0.99"] == {"click-it": 400, "press-it": None}
    assert found["curve"][8]["success"] == {"click-it": None, "press-it": None}
    assert found["curve"][-1]["success"] == {"click-it": 1.0, "press-it": 0.0}


def test_a_curve_is_nan_before_its_first_value_and_constant_after_its_last() -> None:
    curve = [{"env_steps": 100, "success": {"it": None}}, {"env_steps": 200, "success": {"it": 0.5}}]
    curve += [{"env_steps": 300, "success": {"it": 1.0}}]
    drawn = _success_at(np.array([50.0, 150.0, 200.0, 250.0, 300.0, 900.0]), curve, "it")
    np.testing.assert_allclose(drawn, [np.nan, np.nan, 0.5, 0.75, 1.0, 1.0])


def test_curves_are_drawn(tmp_path: Path) -> None:
    draw_successes(tmp_path / "it.png", [record_of("a", 0, [1]), record_of("a", 1, [0]), record_of("b", 0, [1])])
    assert (tmp_path / "it.png").read_bytes().startswith(b"\x89PNG")


def test_a_study_never_mixes_seeds_for_tuning_and_for_reporting() -> None:
    (command,) = [command for command in commands() if command.name == "nets"]
    done = CliRunner().invoke(command, ["--first-seed", "98", "--seeds", "3"])
    assert done.exit_code == 2
    assert "seeds 98 to 100 are partly for reported results and partly for tuning" in done.output


@pytest.mark.parametrize("name", [name for name, study in STUDIES.items() if study.tuning])
def test_a_tuning_study_uses_tuning_seeds_only(name: str) -> None:
    (command,) = [command for command in commands() if command.name == name]
    assert {p.name: p.default for p in command.params}["first_seed"] == 100
    done = CliRunner().invoke(command, ["--first-seed", "0"])
    assert done.exit_code == 2
    assert f"seed 0 is for reported results and {name} is a tuning study: wanted seeds from 100 on" in done.output


def test_runs_of_other_settings_or_versions_have_other_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folders = [one.folder for one in plan(SETTINGS, VARIANTS[:1], [0, 1], tmp_path)]
    folders += [plan((*SETTINGS, "policy.gamma=0.8"), VARIANTS[:1], [0], tmp_path)[0].folder]
    assert plan((*SETTINGS, "policy.gamma=0.9"), VARIANTS[:1], [0], tmp_path)[0].folder == folders[0]  # the default
    monkeypatch.setattr("giirl.studies.runner.VERSION", "another")
    folders += [plan(SETTINGS, VARIANTS[:1], [0], tmp_path)[0].folder]
    assert len(set(folders)) == 4


@pytest.mark.parametrize("name", sorted(STUDIES))
def test_every_study_has_valid_settings_and_a_command(name: str, tmp_path: Path) -> None:
    study = STUDIES[name]
    for demos in (None, tmp_path):
        runs = plan(base_settings(study, demos), study.variants, [0], tmp_path)
        assert len({run.folder for run in runs}) == len(study.variants)
        assert all(run.config.evaluate.episodes == study.pages for run in runs)
    assert name in {command.name for command in commands()}


def test_all_calls_every_command_that_is_not_done_with_the_options_that_it_has(tmp_path: Path) -> None:
    called: list[tuple[object, ...]] = []

    @click.command("figure-x")
    @click.option("--out", type=click.Path(path_type=Path))
    @click.option("--seeds", type=int, default=10)
    @click.option("--json", "json_file", type=click.Path(path_type=Path))
    def figure(out: Path, seeds: int, json_file: Path) -> None:
        called.append(("figure", out, seeds, json_file))

    @click.command("frozen")
    @click.option("--demos", type=click.Path(path_type=Path))
    @click.option("--seeds", type=int, default=1)
    @click.option("--set", "changes", multiple=True)
    @click.option("--json", "json_file", type=click.Path(path_type=Path))
    def study(demos: Path, seeds: int, changes: tuple[str, ...], json_file: Path) -> None:
        called.append(("study", demos, seeds, changes, json_file))

    (everything,) = (command for command in commands() if command.name == "all")
    group = click.Group("reproduce", commands=[figure, study, everything])
    words = ["all", "--demos", "there", "--seeds", "3", "--out", str(tmp_path)]
    CliRunner().invoke(group, words, catch_exceptions=False)
    done = tmp_path / "frozen.json"
    assert called == [
        ("figure", tmp_path, 10, tmp_path / "figure-x.json"),
        ("study", Path("there"), 3, (), done),
    ]
    done.write_text("{}")
    CliRunner().invoke(group, words, catch_exceptions=False)
    assert [each[0] for each in called] == ["figure", "study", "figure"]
