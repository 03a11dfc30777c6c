"""`giirl reward`: the learned reward on its own."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from giirl.cli.demos import writable
from giirl.cli.report import RUN, drawn
from giirl.run.folder import RunFolder
from giirl_core.config import Config
from giirl_core.config_file import load_config
from giirl_core.progress import Display

JSON = click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write the result here.")


@click.group()
def reward() -> None:
    """The learned reward on its own."""


@reward.command()
@RUN
@click.option("--task", default="click-button", show_default=True, help="A task whose goal quotes a button.")
@click.option("--pages", default=500, show_default=True, type=click.IntRange(1), help="Fresh pages.")
@JSON
def goal_swap(run: Path, task: str, pages: int, json_file: Path | None) -> None:
    """How often the reward ranks the goal's button first, and after the goal names another, that one."""
    from giirl.analysis.goal_swap import goal_swap
    from giirl.run.train import reward_of_run
    from giirl_core.metrics import Metrics

    writable(json_file)
    folder, config = _one_task(run, task)
    result = goal_swap(config, reward_of_run(run), task, pages, Metrics(), Display())
    if json_file is not None:
        folder.write_json(json_file, result)
    Display().say(
        f"{task}, {pages} fresh pages: own goal first {100 * result['own_goal_top1']:.1f} %, "
        f"after swapping the goal {100 * result['swapped_goal_top1']:.1f} %"
    )


@reward.command()
@RUN
@click.option("--pages", default=200, show_default=True, type=click.IntRange(2), help="Fresh pages a task.")
@JSON
def sensitivity(run: Path, pages: int, json_file: Path | None) -> None:
    """How well the reward tells an expert's own goal from another page's: an AUC a task, 0.5 for blindness."""
    from giirl.analysis.goal_sensitivity import sensitivity
    from giirl.run.train import reward_of_run
    from giirl_core.metrics import Metrics

    writable(json_file)
    folder, config = _on_pages(run)
    found = sensitivity(config, reward_of_run(run), pages, Metrics(), Display())
    if json_file is not None:
        folder.write_json(json_file, {"tasks": found})
    for task, row in found.items():
        Display().say(f"{task}: AUC {row['auc']:.3f}, shuffled {row['shuffled']:.3f}, {row['pairs']} expert steps")


@reward.command()
@RUN
@click.option("--task", required=True, help="Any task, whether the run trained on it or not.")
@click.option("--seed", required=True, type=click.IntRange(0), help="Of the page; a report names those it shows.")
@click.option("--goal", help="Another instruction for the page; by default its own, naming another element.")
@click.option("--out", type=click.Path(path_type=Path), help="Where the page goes.  [default: RUN/TASK-SEED.html]")
def inspect(run: Path, task: str, seed: int, goal: str | None, out: Path | None) -> None:
    """Draw one page with the learned reward of every element, under its own instruction and under another."""
    from giirl.report.build import inspect
    from giirl_core.types import EpisodeSpec, Goal

    folder, config = _one_task(run, task)
    out = out or folder.path / f"{task}-{seed}.html"
    writable(out)
    other = Goal(goal) if goal is not None else None
    said = [] if goal is None else ["--goal", goal]
    command = shlex.join(["giirl", "reward", "inspect", str(run), "--task", task, "--seed", str(seed), *said])
    inspect(folder, config, EpisodeSpec(task=task, seed=seed), other, out, command)
    drawn(out)


@reward.command()
@RUN
@click.argument("file", type=click.Path(path_type=Path))
@JSON
def score(run: Path, file: Path, json_file: Path | None) -> None:
    """Score every step of the episodes in a demonstration file."""
    from giirl.analysis.scores import score_file, score_table
    from giirl.run.train import reward_of_run

    writable(json_file)
    folder, config = _on_pages(run)
    scored = score_file(config, reward_of_run(run), file)
    if json_file is not None:
        folder.write_json(json_file, scored)
    Display().table(score_table(scored))


@reward.command()
@RUN
@click.option("--port", default=0, show_default="any free one", type=click.IntRange(0, 65535), help="On loopback.")
def serve(run: Path, port: int) -> None:
    """Score what is sent to a loopback port, until Ctrl-C; giirl_core.wire.scoring.ScoreClient asks."""
    from giirl.analysis.scores import serve_reward
    from giirl.run.train import reward_of_run

    _, config = _on_pages(run)
    weights = reward_of_run(run)

    def tell(address: str) -> None:
        click.echo(address)
        Display().say(f"serving the reward of {run}, version {weights.version}; Ctrl-C ends it")

    serve_reward(config, weights, port, tell)


def _one_task(run: Path, task: str) -> tuple[RunFolder, Config]:
    """A run on web pages, to be looked at on one task."""
    from actors.browser import check_tasks

    folder, config = _on_pages(run, f'tasks=["{task}"]')
    check_tasks(config)
    return folder, config


def _on_pages(run: Path, *changes: str) -> tuple[RunFolder, Config]:
    """A run on web pages."""
    folder, _ = RunFolder.open(run)
    config = load_config(folder.config_file, changes)
    if config.world != "miniwob":
        raise ValueError(f"{run} learned in {config.world!r}, which has no pages; wanted a run of world = 'miniwob'")
    return folder, config
