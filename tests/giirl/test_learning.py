"""Training from scratch in the fake browser, with the default settings, solves the tasks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from giirl.analysis.goal_swap import goal_swap
from giirl.run.folder import RunFolder
from giirl.run.train import train
from giirl_core.config_file import load_config
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from learner.checkpoint import latest_checkpoint

SETTINGS = (
    "runtime=serial",
    "browser=fake",
    "net.vectors=hashed",
    "evaluate.episodes=100",
    "evaluate.random_episodes=50",
)


def learn(path: Path, *changes: str) -> dict[str, Any]:
    config = load_config(None, [*SETTINGS, *changes, f"run={path}"])
    return train(config, RunFolder.create(config, "test"), None, Display())


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_giirl_solves_the_four_fake_tasks_and_learns_a_reward_that_depends_on_the_goal(tmp_path: Path) -> None:
    tasks = learn(tmp_path / "run", "iterations=150")["tasks"]
    assert {task: row["success"] for task, row in tasks.items() if row["success"] < 0.95} == {}
    assert tasks["enter-text"]["random"] < 0.2  # random actions do not solve it
    folder, config = RunFolder.open(tmp_path / "run")
    reward = folder.weights(latest_checkpoint(folder.checkpoints), "reward")
    shares = goal_swap(config, reward, "click-button", 100, Metrics(), Display())
    assert shares["own_goal_top1"] > 0.9
    assert shares["swapped_goal_top1"] > 0.9


def test_cloning_generalises_from_demonstrations_to_unseen_pages(tmp_path: Path) -> None:
    setting = ("algorithm=cloning", "rollout_batch=2", 'tasks=["click-test-2", "click-button"]', "net.width=16")
    quick = ("cloning.learning_rate=0.01", "iterations=25", "evaluate.episodes=40", "evaluate.random_episodes=4")
    result = learn(tmp_path / "run", *setting, *quick)
    assert result["algorithm"] == "cloning"
    assert {task: row["success"] for task, row in result["tasks"].items() if row["success"] < 0.9} == {}
