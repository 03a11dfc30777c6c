"""Whole runs and studies in LanguageGridCraft, made small: what they write, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from giirl import grid_settings, run_reproduce
from giirl.cli import giirl
from giirl.config import Config, GridConfig
from giirl.config_file import load_config
from giirl.figures import Panel, draw_maps, draw_returns
from giirl.gridcraft_instructions import Pair
from giirl.gridcraft_layouts import named_layout
from giirl.run_grid import layouts_of, pairs_of
from giirl.run_grid_measures import Measures, means

ROOT = Path(__file__).parents[2]
EXPERIMENT = ROOT / "experiments" / "gridcraft.toml"
PNG = b"\x89PNG\r\n"
QUICK = ["iterations=2", "rollout_batch=2", "discriminator.updates=1", "policy.updates=2", "grid.chance_episodes=5"]


def test_the_experiment_trains_without_a_browser_and_leaves_numbers_and_a_figure(tmp_path: Path) -> None:
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
def test_a_study_writes_its_numbers_and_its_figure(study: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_reproduce, "thesis", small)
    numbers = tmp_path / "numbers.json"
    command = ["reproduce", study, "--json", str(numbers), "--out", str(tmp_path), "--seeds", "2"]
    done = CliRunner().invoke(giirl, command, catch_exceptions=False)
    assert done.exit_code == 0
    result = json.loads(numbers.read_text())
    assert result["seeds"] == 2
    assert {"goals", "reoptimised_over_optimal", "epic", "spearman", "pearson"} <= set(result)
    assert (tmp_path / f"{study}.png").read_bytes().startswith(PNG)


def test_the_joint_study_writes_what_carries_over_and_what_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def tiny(seed: int = 0, colours: str = '["red", "green", "blue"]') -> Config:
        grid = ["grid.random_layouts=1", "grid.layouts=[]", f"grid.colours={colours}", "grid.demonstrations=2"]
        return load_config(EXPERIMENT, [f"seed={seed}", *QUICK, *grid])

    monkeypatch.setattr(run_reproduce, "thesis", small)
    monkeypatch.setattr(run_reproduce, "joint", tiny)
    monkeypatch.setattr(run_reproduce, "few", lambda seed, demonstrations: tiny(seed))
    four = '["red", "green", "blue", "yellow"]'
    monkeypatch.setattr(run_reproduce, "held_out_pairs", lambda seed: tiny(seed, four))
    monkeypatch.setattr(run_reproduce, "DEMONSTRATIONS", (1,))
    monkeypatch.setattr(run_reproduce, "FRESH_ITERATIONS", 1)
    monkeypatch.setattr(run_reproduce, "CLONING_UPDATES", 2)
    numbers = tmp_path / "numbers.json"
    command = ["reproduce", "gridcraft-joint", "--json", str(numbers), "--out", str(tmp_path), "--seeds", "1"]
    done = CliRunner().invoke(giirl, command, catch_exceptions=False)
    assert done.exit_code == 0
    result = json.loads(numbers.read_text())
    for part in ("unseen_layouts", "unseen_pairs"):
        assert set(result[part]) == {"reward_reoptimised", "policy", "cloning"}
    assert {"ranked_below_neutral", "entered", "expert_entered"} <= set(result["avoid"])
    assert set(result["demonstrations"]) == {"1"}
    assert result["steps_to_optimal"]["learned"] == [None]
    assert (tmp_path / "gridcraft-joint.png").read_bytes().startswith(PNG)


def test_held_out_pairs_are_left_to_the_end_and_named_layouts_come_first() -> None:
    grid = GridConfig(held_out=("red-blue",), random_layouts=2)
    assert Pair("red", "blue") not in pairs_of(grid)
    assert len(pairs_of(grid)) == 5
    assert [layout.name for layout in layouts_of(grid)] == ["regions", "random-1000", "random-1001"]


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        (GridConfig(goals=("red",)), "'red' is no pair of colours"),
        (GridConfig(goals=("red-pink",)), "there is no colour 'pink'"),
        (GridConfig(goals=("red-blue",), held_out=("red-blue",)), "holds every goal out"),
        (GridConfig(held_out=("red-yellow",)), "which is none of the 6 goals"),
        (GridConfig(layouts=("region",)), "there is no layout 'region'"),
        (GridConfig(layouts=()), "got none"),
    ],
)
def test_a_grid_that_cannot_be_is_one_line(grid: GridConfig, said: str, tmp_path: Path) -> None:
    from giirl.run_grid import learn

    with pytest.raises(ValueError, match=said) as caught:
        learn(Config(world="gridcraft", iterations=1, grid=grid))
    assert "\n" not in str(caught.value)


def test_a_mean_leaves_out_what_is_not_a_number() -> None:
    def one(value: float) -> Measures:
        names = [name for name in Measures.__slots__ if name != "pair"]
        return Measures(pair=Pair("red", "blue"), **dict.fromkeys(names, 1.0) | {"matched_avoid_rank": value})

    assert means([one(0.5), one(float("nan"))])["matched_avoid_rank"] == 0.5
    assert np.isnan(means([one(float("nan"))])["matched_avoid_rank"])


def test_the_figures_are_drawn_into_folders_that_are_not_there_yet(tmp_path: Path) -> None:
    layout = named_layout("rooms")
    values = np.where(layout.cells < 0, np.nan, 0.5)
    draw_maps(tmp_path / "a" / "maps.png", layout, [Panel(title="Go to Red.", values=values)])
    curves = {str(i): np.ones((2, 3)) for i in range(4)}
    draw_returns(tmp_path / "b" / "returns.png", np.array([1, 2, 3]), curves)
    assert (tmp_path / "a" / "maps.png").read_bytes().startswith(PNG)
    assert (tmp_path / "b" / "returns.png").read_bytes().startswith(PNG)
