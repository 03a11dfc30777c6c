"""Train, evaluate and load runs from Python: what `giirl train` and `giirl evaluate` do, as functions.

config = load_config(Path("experiments/miniwob_four.toml"), ["runtime=serial"])
folder = RunFolder.create(config, "mine")
result = train(config, folder)
reward, policy = load_reward(folder.path), load_policy(folder.path)
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from giirl.run.folder import RunFolder
from giirl_core.config import Config
from giirl_core.config_file import load_config
from giirl_core.progress import Display
from learner.checkpoint import latest_checkpoint

if TYPE_CHECKING:
    from rich.table import Table

    from actors.agents import PolicyAgent
    from giirl_core.nets.reward import RewardModel


def train(
    config: Config, folder: RunFolder, checkpoint: Path | None = None, display: Display | None = None
) -> dict[str, Any]:
    """Train in `folder`, evaluate, write result.json and return what is in it.

    `checkpoint` is one of the folder's checkpoints and resumes from there. A run that fails before its first
    checkpoint removes what it wrote. SIGINT and SIGTERM save a checkpoint and raise `giirl.signals.Stopped`.
    """
    display = display or Display()
    try:
        if config.world == "gridcraft":
            from giirl.run.grid import train_grid

            result = train_grid(config, folder, checkpoint, display)
        else:
            if config.runtime != "serial":  # a missing Ray is reported before demonstrations are made
                import_module("giirl_core.processes.ray_platform")
            from giirl.run.train import train as train_on_pages

            result = train_on_pages(config, folder, checkpoint, display)
    except BaseException:
        if checkpoint is None:
            folder.discard_unless_begun()
        raise
    folder.write_json(folder.result, result)
    return result


def evaluate(run: Path, overrides: Sequence[str] = (), display: Display | None = None) -> dict[str, Any]:
    """Success of a run's greedy policy on fresh pages with the random baseline; or its return in LanguageGridCraft.

    `overrides` are settings as `key=value`, such as "evaluate.episodes=500". The result has the form of result.json.
    """
    folder, _ = RunFolder.open(run)
    config = load_config(folder.config_file, overrides)
    checkpoint = latest_checkpoint(folder.checkpoints)
    start_s, points = time.monotonic(), folder.points()
    result: dict[str, Any]
    if config.world == "gridcraft":
        from giirl.run.grid import evaluate_grid, open_run

        result = evaluate_grid(config, open_run(config, checkpoint))
    else:
        from actors.browser import check_tasks
        from giirl.run.evaluate import evaluate as evaluate_on_pages
        from giirl_core.metrics import Metrics

        check_tasks(config)
        policy = folder.weights(checkpoint, "policy")
        result = {
            "tasks": evaluate_on_pages(config, policy, Metrics(), display or Display()),
            "env_steps": points[-1]["env_steps"] if points else 0,
            "algorithm": config.algorithm,
            "seed": config.seed,
        }
    result["seconds"] = round(time.monotonic() - start_s, 1)
    return result


def result_table(result: dict[str, Any]) -> Table:
    """The result of `train` or `evaluate` as a table for the terminal."""
    if "goals" in result:
        from giirl.run.grid import grid_table

        return grid_table(result)
    from giirl.run.evaluate import result_table as table_of_tasks

    return table_of_tasks(result)


def load_reward(run: Path) -> RewardModel:
    """The learned reward r(s, a | g) of a run on web pages, from its last checkpoint; ValueError if it has none."""
    from giirl.run.train import reward_of_run
    from giirl_core.nets.reward import build_reward

    _, config = _on_pages(run)
    return build_reward(config, reward_of_run(run))


def load_policy(run: Path, *, greedy: bool = True) -> PolicyAgent:
    """The policy of a run on web pages, from its last checkpoint: greedy, or sampling its actions."""
    from actors.agents import PolicyAgent
    from giirl_core.nets.language import load_vectors
    from giirl_core.nets.reward import build_policy

    folder, config = _on_pages(run)
    agent = PolicyAgent(build_policy(config), load_vectors(config.net.vectors), greedy=greedy)
    agent.load(folder.weights(latest_checkpoint(folder.checkpoints), "policy"))
    return agent


def _on_pages(run: Path) -> tuple[RunFolder, Config]:
    folder, config = RunFolder.open(run)
    if config.world != "miniwob":
        raise ValueError(f"{run} is a run with world = {config.world!r}, wanted one with world = 'miniwob'")
    return folder, config
