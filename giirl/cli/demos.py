"""`giirl demos`: demonstrations made, imported and looked at."""

from __future__ import annotations

import json
from pathlib import Path

import click

from giirl.run.demo_stats import stats_table
from giirl_core.config import DEFAULT_TASKS
from giirl_core.config_file import load_config
from giirl_core.files import atomic_write
from giirl_core.progress import Display
from giirl_core.types import Episode
from giirl_core.wire.messages import read_episodes, write_episodes

STEPS = "step_limit=100"  # more than any expert needs: a good price may take 76 to come
OUT = click.option("--out", required=True, type=click.Path(path_type=Path), help="The file to write.")
TASKS = click.option("--task", "tasks", multiple=True, help="A task; may be given again. The thesis's four if not.")


@click.group()
def demos() -> None:
    """Demonstrations: from scripted experts or from people."""


@demos.command()
@OUT
@TASKS
@click.option("--per-task", default=100, show_default=True, type=click.IntRange(1), help="Episodes a task.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Other seeds, other pages.")
@click.option("--browser", default="chrome", type=click.Choice(["chrome", "fake"]), help="fake is for tests.")
def make(out: Path, tasks: tuple[str, ...], per_task: int, seed: int, browser: str) -> None:
    """Let the scripted experts play real pages."""
    from giirl.run.demonstrations import make
    from giirl_core.metrics import Metrics

    writable(out)
    names = list(tasks or DEFAULT_TASKS)
    changes = [f"tasks={names!r}", f"demos.per_task={per_task}", f"seed={seed}", f"browser={browser}", STEPS]
    _save(out, make(load_config(None, changes), Metrics(), Display()), wanted=per_task)


@demos.command()
@click.option("--task", "tasks", multiple=True, help="A task; may be given again. Every task with an expert if not.")
@click.option("--episodes", default=200, show_default=True, type=click.IntRange(1), help="Pages a task.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Other seeds, other pages.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write the result here, task by task.")
@click.option("--resume", is_flag=True, help="Keep what the --json file has, and play the tasks that it lacks.")
def experts(tasks: tuple[str, ...], episodes: int, seed: int, json_file: Path | None, resume: bool) -> None:
    """How often the scripted experts succeed."""
    from browser_farm.experts import EXPERTS
    from giirl.run.experts import experts_table, known, measure
    from giirl_core.metrics import Metrics

    writable(json_file)
    names = list(tasks or sorted(EXPERTS))
    config = load_config(None, [f"tasks={names!r}", f"seed={seed}", "actors.tabs=16", STEPS])
    rows = known(json_file, episodes, seed) if resume and json_file is not None else {}
    result = {"episodes": episodes, "seed": seed, "tasks": rows}
    for result in measure(config, episodes, Metrics(), Display(), rows):
        if json_file is not None:
            with atomic_write(json_file) as file:
                file.write(json.dumps(result, indent=1).encode() + b"\n")
    Display().table(experts_table(result))


@demos.command()
@OUT
@TASKS
@click.option("--per-task", default=10, show_default=True, type=click.IntRange(1), help="Pages a task.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Other seeds, other pages.")
def record(out: Path, tasks: tuple[str, ...], per_task: int, seed: int) -> None:
    """Record what you do in a Chrome window; Ctrl-C ends it and keeps what is finished.

    Clicks, typing, drags, keys and scrolled text become actions, failures stay, marked. A mouse that only rests
    somewhere is not recorded.
    """
    from giirl.run.record import record

    writable(out)
    _save(out, record(tasks or DEFAULT_TASKS, per_task, seed, Display()), wanted=None)


@demos.command(name="import")
@click.argument("folder", type=click.Path(path_type=Path))
@OUT
@click.option("--task", "tasks", multiple=True, help="A task; may be given again. All that FOLDER has if not.")
@click.option("--per-task", type=click.IntRange(1), help="At most so many clean ones a task.")
@click.option("--collection", "collections", multiple=True, help="Only this folder of FOLDER; may be given again.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write what became of each task here.")
def import_(
    folder: Path,
    out: Path,
    tasks: tuple[str, ...],
    per_task: int | None,
    collections: tuple[str, ...],
    json_file: Path | None,
) -> None:
    """Turn public human recordings (COLLECTION/TASK/*.json.gz) into demonstrations; failures stay, marked."""
    from giirl.run.demonstrations import recorded

    writable(out)
    writable(json_file)
    episodes, report = recorded(folder, tasks, per_task, collections or None, Display())
    for line in report.lines():
        click.echo(line)
    _save(out, episodes, wanted=None)
    if json_file is not None:
        json_file.write_text(json.dumps(report.summary(), indent=1) + "\n", encoding="utf-8")


@demos.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
def stats(files: tuple[Path, ...]) -> None:
    """What demonstration files hold."""
    for file in files:
        with Display().busy(f"reading {file}"):
            episodes = read_episodes(file)
        Display().table(stats_table(str(file), episodes))


def writable(path: Path | None) -> None:
    """ValueError where a result could not be written; better now than after an hour."""
    if path is not None and (path.is_dir() or not path.absolute().parent.is_dir()):
        raise ValueError(f"cannot write {path}: wanted a file in a folder that exists")


def _save(out: Path, episodes: list[Episode], wanted: int | None) -> None:
    if not episodes:
        raise ValueError("there is no demonstration to write")
    write_episodes(out, episodes)
    Display().table(stats_table(str(out), episodes))
    for task in sorted({episode.trajectory.task for episode in episodes}):
        won = sum(e.outcome.success for e in episodes if e.trajectory.task == task)
        if wanted is not None and won < wanted:
            raise ValueError(f"the expert of {task} succeeded {won} times of {wanted}; {out} holds what did")
