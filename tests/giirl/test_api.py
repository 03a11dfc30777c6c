"""Training, evaluating and loading a run from Python."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from giirl import RunFolder, evaluate, load_policy, load_reward, read_episodes, train
from giirl.run.worlds import WORLDS
from tests.giirl.small import config


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """A finished run."""
    settings = config(tmp_path_factory.mktemp("api") / "run")
    folder = RunFolder.create(settings, "test")
    train(settings, folder)
    return folder


def test_training_writes_the_result_that_it_returns(folder: RunFolder) -> None:
    result = json.loads(folder.result.read_text())
    assert result["training_episodes"] == 4 * 8
    assert WORLDS["miniwob"].table(result).row_count == len(result["tasks"]) == 4


def test_evaluating_a_run_again_gives_the_same_result_and_takes_other_settings(folder: RunFolder) -> None:
    assert evaluate(folder.path)["tasks"] == json.loads(folder.result.read_text())["tasks"]
    more = evaluate(folder.path, ["evaluate.episodes=6"])
    assert {row["episodes"] for row in more["tasks"].values()} == {6}


def test_a_loaded_policy_acts_and_a_loaded_reward_scores_its_actions(folder: RunFolder) -> None:
    policy, reward = load_policy(folder.path), load_reward(folder.path)
    trajectory = read_episodes(folder.demonstrations)[0].trajectory
    [rewards] = reward.score([trajectory])
    assert rewards.shape == (len(trajectory),)
    assert np.all(np.isfinite(rewards))
    scored = reward.score_actions(trajectory.pages[0], trajectory.goal, [trajectory.actions[0]])
    assert scored[0] == pytest.approx(rewards[0], abs=1e-5)
    assert policy.greedy
    assert policy.version == 4
    assert not load_policy(folder.path, greedy=False).greedy


def test_training_that_fails_at_its_start_leaves_no_folder(tmp_path: Path) -> None:
    settings = config(tmp_path / "run", "demos.source=file", f"demos.path={tmp_path / 'nowhere'}")
    with pytest.raises(OSError, match="nowhere"):
        train(settings, RunFolder.create(settings, "test"))
    assert not (tmp_path / "run").exists()


def test_a_grid_run_trains_and_evaluates_by_the_same_calls_and_has_no_reward_on_pages(tmp_path: Path) -> None:
    settings = config(tmp_path / "run", "world=gridcraft", 'grid.goals=["red-blue"]', "grid.demonstrations=2")
    folder = RunFolder.create(settings, "test")
    result = train(settings, folder)
    assert evaluate(folder.path)["parameters_sha256"] == result["parameters_sha256"]
    assert WORLDS["gridcraft"].table(result).row_count == 1
    for load in (load_reward, load_policy):
        with pytest.raises(ValueError, match="which has no pages: wanted a run with world = 'miniwob'"):
            load(folder.path)
