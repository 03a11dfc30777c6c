"""The two worlds that a run can learn in, as objects with the same functions. `giirl.report.worlds` draws them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from giirl.run.folder import RunFolder
from giirl_core.algorithms import WorldName
from giirl_core.config import Config
from giirl_core.config_file import load_config
from giirl_core.gestures import read_gestures
from giirl_core.progress import Display

if TYPE_CHECKING:
    from rich.table import Table


class World(Protocol):
    """What commands do with a run. `has_pages`: its episodes are played in a browser."""

    has_pages: bool

    def check(self, config: Config) -> None:
        """ValueError for a task that does not exist."""

    def train(self, config: Config, folder: RunFolder, checkpoint: Path | None, display: Display) -> dict[str, Any]:
        """Train from the start, or from a checkpoint of the run, evaluate, and return the result.

        Raises `giirl.signals.Stopped` after Ctrl-C, SIGTERM or SIGHUP, with a checkpoint saved.
        """

    def evaluate(self, config: Config, folder: RunFolder, checkpoint: Path, display: Display) -> dict[str, Any]:
        """The result of a checkpoint, measured again with the settings of `config`."""

    def table(self, result: dict[str, Any]) -> Table:
        """A result as a table for the terminal."""


class Web:
    """MiniWoB pages in Chrome or in the fake browser."""

    has_pages = True

    def check(self, config: Config) -> None:
        from actors.browser import check_tasks
        from actors.workflows import read_workflows

        check_tasks(config)
        read_gestures(config.net.gestures)
        read_workflows(config.demos.workflows)

    def train(self, config: Config, folder: RunFolder, checkpoint: Path | None, display: Display) -> dict[str, Any]:
        if config.runtime != "serial":  # a missing Ray is reported before demonstrations are made
            import giirl_core.processes.ray_platform  # noqa: F401
        from giirl.run.train import train

        return train(config, folder, checkpoint, display)

    def evaluate(self, config: Config, folder: RunFolder, checkpoint: Path, display: Display) -> dict[str, Any]:
        from giirl.run.evaluate import evaluate
        from giirl_core.metrics import Metrics

        points = folder.points()
        replayed = folder.load_demonstrations() if config.evaluate.agent == "replay" else []
        return {
            "tasks": evaluate(
                config,
                folder.weights(checkpoint, "policy"),
                Metrics(),
                display,
                demonstrations=[episode.trajectory for episode in replayed],
            ),
            "env_steps": points[-1]["env_steps"] if points else 0,
            "algorithm": config.algorithm,
            "seed": config.seed,
        }

    def table(self, result: dict[str, Any]) -> Table:
        from giirl.run.evaluate import result_table

        return result_table(result)


class Grid:
    """LanguageGridCraft, which needs no browser."""

    has_pages = False

    def check(self, config: Config) -> None:
        """Nothing: layouts and goals are checked where they are built."""

    def train(self, config: Config, folder: RunFolder, checkpoint: Path | None, display: Display) -> dict[str, Any]:
        from giirl.run.grid import train_grid

        return train_grid(config, folder, checkpoint, display)

    def evaluate(self, config: Config, folder: RunFolder, checkpoint: Path, display: Display) -> dict[str, Any]:
        from giirl.run.grid import evaluate_grid, open_run

        return evaluate_grid(config, open_run(config, checkpoint))

    def table(self, result: dict[str, Any]) -> Table:
        from giirl.run.grid import grid_table

        return grid_table(result)


WORLDS: dict[WorldName, World] = {"miniwob": Web(), "gridcraft": Grid()}


def world_of(config: Config) -> World:
    """The world that a config names."""
    return WORLDS[config.world]


def open_web_run(run: Path, *overrides: str) -> tuple[RunFolder, Config]:
    """The folder and config of a run on web pages, with `overrides` as `key=value`; ValueError for another world."""
    folder, _ = RunFolder.open(run)
    config = load_config(folder.config_file, overrides)
    if not world_of(config).has_pages:
        raise ValueError(f"{run} has world = {config.world!r}, which has no pages: wanted a run with world = 'miniwob'")
    return folder, config
