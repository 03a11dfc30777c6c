"""The `giirl demos` commands: make, record, import and inspect demonstrations."""

from __future__ import annotations

from pathlib import Path

import click

from giirl.cli.options import JSON, OUT, SEED, TASKS, Place, save_json
from giirl.run.demo_stats import stats_table
from giirl_core.config import DEFAULT_TASKS
from giirl_core.config_file import load_config
from giirl_core.files import explain
from giirl_core.progress import Display
from giirl_core.types import Episode
from giirl_core.wire.messages import read_episodes, read_sound_episodes, write_episodes

STEP_LIMIT = "step_limit=100"  # more than any expert needs: some pages make it wait for up to 76 steps


@click.group()
def demos() -> None:
    """Demonstrations by scripted experts or people."""


@demos.command()
@OUT
@TASKS
@click.option("--per-task", default=100, show_default=True, type=click.IntRange(1), help="Episodes per task.")
@SEED
@click.option("--browser", default="chrome", type=click.Choice(["chrome", "fake"]), help="fake is for tests.")
def make(out: Path, tasks: tuple[str, ...], per_task: int, seed: int, browser: str) -> None:
    """Let the scripted experts play real pages."""
    from giirl.run.demonstrations import make
    from giirl_core.metrics import Metrics

    names = list(tasks or DEFAULT_TASKS)
    changes = [f"tasks={names!r}", f"demos.per_task={per_task}", f"seed={seed}", f"browser={browser}", STEP_LIMIT]
    _save(out, make(load_config(None, changes), Metrics(), Display()), wanted=per_task)


@demos.command()
@click.option("--task", "tasks", multiple=True, help="A task; may be given again.  [default: all with an expert]")
@click.option("--episodes", default=200, show_default=True, type=click.IntRange(1), help="Pages per task.")
@SEED
@JSON
@click.option("--resume", is_flag=True, help="Keep the tasks in the --json file, and play only the others.")
def experts(tasks: tuple[str, ...], episodes: int, seed: int, json_file: Path | None, resume: bool) -> None:
    """Measure how often the scripted experts succeed."""
    from browser_farm.experts import EXPERTS
    from giirl.run.experts import experts_table, measure, read_rows
    from giirl_core.metrics import Metrics

    names = list(tasks or sorted(EXPERTS))
    config = load_config(None, [f"tasks={names!r}", f"seed={seed}", "actors.tabs=16", STEP_LIMIT])
    rows = read_rows(json_file, episodes, seed) if resume and json_file is not None else {}
    result = {"episodes": episodes, "seed": seed, "tasks": rows}
    for result in measure(config, episodes, Metrics(), Display(), rows):
        save_json(json_file, result)
    Display().table(experts_table(result))


@demos.command()
@OUT
@TASKS
@click.option("--per-task", default=10, show_default=True, type=click.IntRange(1), help="Episodes per task.")
@SEED
def record(out: Path, tasks: tuple[str, ...], per_task: int, seed: int) -> None:
    """Record what you do in a Chrome window. Ctrl-C ends the recording and keeps the finished episodes.

    A task is one of MiniWoB's, or a task file: beside its page a second window shows the instruction, and lets you
    discard an episode, do it again, mark it as failed, or say that it is done. Passwords are not stored.

    Clicks, typing, drags, keys and scrolled text become actions. Failed episodes are kept and marked. Hovering is not
    recorded. A file that is there already is continued.
    """
    from giirl.run.record import record

    episodes = read_episodes(out) if out.is_file() else []
    for episode in record(tasks or DEFAULT_TASKS, per_task, seed, Display(), episodes):
        episodes.append(episode)
        write_episodes(out, episodes)  # at once: whatever ends the recording, what a person did is there
    _save(out, episodes, wanted=None)


@demos.command(name="import")
@click.argument("folder", type=Place())
@OUT
@click.option("--task", "tasks", multiple=True, help="A task; may be given again.  [default: every task in FOLDER]")
@click.option("--per-task", type=click.IntRange(1), help="Maximum number of recordings without errors per task.")
@click.option("--collection", "collections", multiple=True, help="Only this folder of FOLDER; may be given again.")
@JSON
def import_(
    folder: Path,
    out: Path,
    tasks: tuple[str, ...],
    per_task: int | None,
    collections: tuple[str, ...],
    json_file: Path | None,
) -> None:
    """Convert public human recordings (COLLECTION/TASK/*.json.gz) into demonstrations.

    Failed episodes are kept and marked. The JSON says for each task why recordings were left out. Files that cannot be
    read are left out too; the exit status is then 1.
    """
    from giirl.run.demonstrations import import_folder, left_out

    episodes, report = import_folder(folder, tasks, per_task, collections or None, Display())
    try:
        _save(out, episodes, wanted=None)
    finally:
        save_json(json_file, report.summary())
        for line in report.lines():
            click.echo(line)
    if report.unreadable:
        raise ValueError(f"{left_out(report.unreadable)}; {out} has the others")


@demos.command()
@click.argument("files", nargs=-1, required=True, type=Place())
def stats(files: tuple[Path, ...]) -> None:
    """Print what demonstration files contain, as far as they can be read; the exit status is 1 if one is damaged."""
    wrong: list[str] = []
    for file in files:
        try:
            with Display().busy(f"reading {file}"):
                episodes, damage = read_sound_episodes(file)
            wrong += [f"{file} is damaged at {one}" for one in damage]
            Display().table(stats_table(str(file), episodes))
        except (ValueError, OSError) as error:
            wrong.append(explain(error))
    if len(wrong) > 1:
        raise ValueError(f"{len(wrong)} faults, the first: {wrong[0]}")
    if wrong:
        raise ValueError(wrong[0])


def _save(out: Path, episodes: list[Episode], wanted: int | None) -> None:
    """Write the episodes; ValueError if a task has fewer than `wanted` successes, which are then written anyway."""
    if not episodes:
        raise ValueError("there is no demonstration to write")
    write_episodes(out, episodes)
    Display().table(stats_table(str(out), episodes))
    for task in sorted({episode.trajectory.task for episode in episodes}):
        won = sum(e.outcome.success for e in episodes if e.trajectory.task == task)
        if wanted is not None and won < wanted:
            raise ValueError(f"the expert of {task} succeeded {won} times, wanted {wanted}; {out} has the successes")
