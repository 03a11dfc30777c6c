"""Small runs and studies in LanguageGridCraft: the files that they write, and their errors."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from threading import Event

import numpy as np
import pytest
from click.testing import CliRunner, Result

from giirl.cli.main import giirl
from giirl.figures import Panel, draw_maps, draw_returns
from giirl.run.grid import continue_run, layouts_of, open_run, pairs_of
from giirl.run.grid_metrics import Measures, means
from giirl.signals import Stopped
from giirl.studies import grid_ablations as run_ablations
from giirl.studies import grid_figures as run_reproduce
from giirl.studies import grid_joint as run_joint
from giirl.studies import grid_settings
from giirl_core.config import Config, GridConfig
from giirl_core.config_file import load_config
from giirl_core.nets.parameters import hash_nets
from gridcraft.instructions import ColourPair
from gridcraft.layouts import named_layout

ROOT = Path(__file__).parents[3]
EXPERIMENT = ROOT / "experiments" / "gridcraft.toml"
PNG = b"\x89PNG\r\n"
QUICK = ["iterations=2", "rollout_batch=2", "discriminator.updates=1", "policy.updates=2", "grid.random_episodes=5"]


def invoke(*words: str) -> Result:
    return CliRunner().invoke(giirl, list(words), catch_exceptions=False)


def test_the_experiment_trains_without_a_browser_and_writes_a_result_and_a_figure(tmp_path: Path) -> None:
    run = tmp_path / "run"
    done = CliRunner().invoke(giirl, ["train", str(EXPERIMENT), f"run={run}", *QUICK], catch_exceptions=False)
    assert done.exit_code == 0
    result = json.loads((run / "result.json").read_text())
    assert len(result["goals"]) == 6
    assert {"epic", "spearman", "pearson", "env_steps", "cpu_seconds", "avoid", "late_minimum"} <= set(result)
    assert (run / "reward.png").read_bytes().startswith(PNG)
    assert "Go to Red. Avoid Blue." in done.output


def test_the_experiment_has_the_settings_of_the_study() -> None:
    assert load_config(EXPERIMENT) == grid_settings.thesis()


def small(seed: int = 0) -> Config:
    return load_config(EXPERIMENT, [f"seed={seed}", *QUICK])


@pytest.mark.parametrize("study", ["figure-4.3", "figure-4.4"])
def test_a_study_writes_its_result_and_its_figure(study: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_reproduce, "thesis", small)
    numbers = tmp_path / "numbers.json"
    command = ["reproduce", study, "--json", str(numbers), "--out", str(tmp_path), "--seeds", "2"]
    done = CliRunner().invoke(giirl, command, catch_exceptions=False)
    assert done.exit_code == 0
    result = json.loads(numbers.read_text())
    assert result["seeds"] == 2
    assert {"goals", "reoptimised_over_optimal", "epic", "spearman", "pearson"} <= set(result)
    assert (tmp_path / f"{study}.png").read_bytes().startswith(PNG)


def test_the_joint_study_writes_its_transfer_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def tiny(seed: int = 0, held_out: str = "[]", colours: str = '["red", "green", "blue"]') -> Config:
        grid = ["grid.random_layouts=1", "grid.layouts=[]", "grid.demonstrations=2", f"grid.held_out={held_out}"]
        return load_config(EXPERIMENT, [f"seed={seed}", *QUICK, *grid, f"grid.colours={colours}"])

    monkeypatch.setattr(run_ablations, "thesis", small)
    monkeypatch.setattr(run_ablations, "FRESH_ITERATIONS", 1)
    monkeypatch.setattr(run_joint, "joint", tiny)
    monkeypatch.setattr(run_joint, "few", lambda seed, demonstrations: tiny(seed))
    four = '["red", "green", "blue", "yellow"]'
    monkeypatch.setattr(run_joint, "held_out_pairs", lambda seed: tiny(seed, '["red-green"]', four))
    monkeypatch.setattr(run_joint, "held_out_of_three", lambda seed, rename: tiny(seed, '["red-green"]'))
    monkeypatch.setattr(run_joint, "FEW", (1,))
    monkeypatch.setattr(run_joint, "CLONING_UPDATES", 2)
    numbers = tmp_path / "numbers.json"
    command = ["reproduce", "gridcraft-joint", "--json", str(numbers), "--out", str(tmp_path), "--seeds", "1"]
    assert invoke(*command).exit_code == 0
    result = json.loads(numbers.read_text())
    for part in (result["unseen_layouts"], result["unseen_pairs"], result["unseen_pairs_of_three"]["plain"]):
        assert {"reward_reoptimised", "policy", "cloning"} <= set(part)
    assert {"ranked_below_neutral", "entered", "expert_entered"} <= set(result["avoid"])
    assert set(result["demonstrations"]) == {"1", "2"}
    assert result["steps_to_optimal"]["learned"] == [None]
    assert result["steps_to_optimal"]["sparse"] == [[None] * 3]
    assert (tmp_path / "gridcraft-joint.png").read_bytes().startswith(PNG)


def test_each_ablation_has_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_ablations, "thesis", small)
    monkeypatch.setattr(grid_settings, "thesis", small)
    monkeypatch.setattr(run_ablations, "FRESH_ITERATIONS", 1)
    rows = {name: grid_settings.ABLATIONS[name] for name in ("as reported", "plain Algorithm 1", "single words")}
    monkeypatch.setattr(run_ablations, "ABLATIONS", rows)
    numbers = tmp_path / "numbers.json"
    done = invoke("reproduce", "gridcraft-ablations", "--json", str(numbers), "--seeds", "1")
    assert done.exit_code == 0
    result = json.loads(numbers.read_text())
    assert set(result["ablations"]) == set(rows)
    assert len({row["epic"] for row in result["ablations"].values()}) == len(rows)
    assert "plain Algorithm 1" in done.output


@pytest.mark.parametrize("name", grid_settings.ABLATIONS)
def test_every_ablation_but_the_first_changes_a_setting(name: str) -> None:
    assert (grid_settings.ablated(3, name) == grid_settings.thesis(3)) == (name == "as reported")


def test_held_out_pairs_are_not_trained_on_and_named_layouts_come_first() -> None:
    grid = GridConfig(held_out=("red-blue",), random_layouts=2)
    assert ColourPair("red", "blue") not in pairs_of(grid)
    assert len(pairs_of(grid)) == 5
    assert [layout.name for layout in layouts_of(grid)] == ["regions", "random-1000", "random-1001"]


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (GridConfig(goals=("red",)), "'red' is not a pair of colours"),
        (GridConfig(goals=("red-pink",)), "there is no colour 'pink'"),
        (GridConfig(goals=("red-blue",), held_out=("red-blue",)), "holds every goal out"),
        (GridConfig(held_out=("red-yellow",)), "which is none of the 6 goals"),
        (GridConfig(layouts=("region",)), "there is no layout 'region'"),
        (GridConfig(layouts=()), "got none"),
    ],
)
def test_an_illegal_grid_is_an_error_of_one_line(grid: GridConfig, message: str, tmp_path: Path) -> None:
    from giirl.run.grid import learn

    with pytest.raises(ValueError, match=message) as caught:
        learn(Config(world="gridcraft", iterations=1, grid=grid))
    assert "\n" not in str(caught.value)


def test_a_mean_leaves_out_nan() -> None:
    def one(value: float) -> Measures:
        names = [name for name in Measures.__slots__ if name != "pair"]
        return Measures(pair=ColourPair("red", "blue"), **dict.fromkeys(names, 1.0) | {"matched_avoid_rank": value})

    assert means([one(0.5), one(float("nan"))])["matched_avoid_rank"] == 0.5
    assert np.isnan(means([one(float("nan"))])["matched_avoid_rank"])


def test_figures_create_their_folders(tmp_path: Path) -> None:
    layout = named_layout("rooms")
    values = np.where(layout.cells < 0, np.nan, 0.5)
    draw_maps(tmp_path / "a" / "maps.png", layout, [Panel(title="Go to Red.", values=values)])
    curves = {str(i): np.ones((2, 3)) for i in range(4)}
    draw_returns(tmp_path / "b" / "returns.png", np.array([1, 2, 3]), curves)
    assert (tmp_path / "a" / "maps.png").read_bytes().startswith(PNG)
    assert (tmp_path / "b" / "returns.png").read_bytes().startswith(PNG)


def test_a_run_resumed_from_a_checkpoint_ends_like_an_uninterrupted_one(tmp_path: Path) -> None:
    whole, parted = tmp_path / "whole", tmp_path / "parted"
    settings = [str(EXPERIMENT), *QUICK, "iterations=4", "checkpoint_every=2", "grid.measure_every=1"]
    for run in (whole, parted):
        assert invoke("train", *settings, f"run={run}").exit_code == 0
    (parted / "checkpoints/latest").write_text("step-00000002")
    (parted / "result.json").unlink()
    assert invoke("train", "--resume", str(parted)).exit_code == 0
    one, two = (json.loads((run / "result.json").read_text()) for run in (whole, parted))
    for result in (one, two):
        del result["seconds"], result["cpu_seconds"]
    assert one == two
    assert (whole / "curve.jsonl").read_text() == (parted / "curve.jsonl").read_text()


def hash_after_resuming(checkpoint: Path) -> str:
    """The hash of the nets after two more iterations from a checkpoint."""
    longer = dataclasses.replace(small(), iterations=4)
    again = open_run(longer, checkpoint)
    continue_run(longer, again, lambda: None)
    return hash_nets(*again.learner.nets().values())


@pytest.fixture(scope="module")
def checkpoints(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, str]:
    """A checkpoint before training, one after two iterations, and the hash after resuming from the second."""
    folder = tmp_path_factory.mktemp("checkpoints")
    before, after = folder / "before", folder / "after"
    run = open_run(small())
    for path in (before, after):
        path.mkdir()
        run.save(path)
        continue_run(small(), run, lambda: None)
    return before, after, hash_after_resuming(after)


@pytest.mark.parametrize("lost", ["reward_replay", "policy_replay", "q", "policy_optimiser", "reward_optimiser"])
def test_every_file_of_a_grid_checkpoint_is_needed_to_resume(
    lost: str, checkpoints: tuple[Path, Path, str], tmp_path: Path
) -> None:
    before, after, end = checkpoints
    mixed = tmp_path / "mixed"
    shutil.copytree(after, mixed)
    shutil.copy(before / f"{lost}.safetensors", mixed)
    assert hash_after_resuming(mixed) != end


def test_a_stopped_run_ends_after_its_step_and_a_finished_one_can_be_evaluated_again(tmp_path: Path) -> None:
    config, stop = small(), Event()
    run = open_run(config)
    with pytest.raises(Stopped):
        continue_run(config, run, stop.set, stop)
    assert run.learner.version == 1
    path = tmp_path / "run"
    assert invoke("train", str(EXPERIMENT), f"run={path}", *QUICK).exit_code == 0
    numbers = tmp_path / "again.json"
    assert invoke("evaluate", str(path), "--json", str(numbers)).exit_code == 0
    first, again = (json.loads(file.read_text()) for file in (path / "result.json", numbers))
    assert again["goals"] == first["goals"]
    assert invoke("evaluate", str(path), 'grid.layouts=["rooms"]', "--json", str(numbers)).exit_code == 0
    assert json.loads(numbers.read_text())["goals"] != first["goals"]
    with pytest.raises(ValueError, match="which has no pages"):
        invoke("reward", "goal-swap", str(path))
