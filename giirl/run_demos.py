"""Demonstrations: made by the scripted experts, read from a file, or imported from human recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from actors.choosers import ExpertChooser
from actors.rollouts import Schedule, play
from browser_farm.experts import expert
from browser_farm.recordings import ImportReport, find_recordings, import_recordings
from giirl.config import Config
from giirl.metrics import Metrics
from giirl.progress import Display
from giirl.run_browser import open_browser
from giirl.spec import Episode, Purpose
from giirl.wire import read_episodes


def gather(config: Config, metrics: Metrics, display: Display) -> list[Episode]:
    """The successful demonstrations that a config asks for, at most `demos.per_task` of each task."""
    if config.demos.source == "scripted":
        return chosen(make(config, metrics, display), config, "the scripted expert")
    if not config.demos.path:
        raise ValueError(f"demos.source is {config.demos.source!r}: wanted demos.path=FILE_OR_FOLDER beside it")
    path = Path(config.demos.path)
    if config.demos.source == "recordings":
        episodes, _ = recorded(path, config.tasks, config.demos.per_task, config.demos.collections or None, display)
    else:
        episodes = read_episodes(path)
    return chosen(episodes, config, str(path))


def make(config: Config, metrics: Metrics, display: Display) -> list[Episode]:
    """Let the scripted experts play pages that no training or evaluation uses; keep what succeeded."""
    for task in config.tasks:
        expert(task)  # a task without an expert is an error before any browser starts
    browser = open_browser(config, metrics)
    wanted = config.demos.per_task
    schedule = Schedule(config.tasks, browser.tabs, purpose=Purpose.DEMONSTRATE, run_seed=config.seed, quota=wanted)
    made: list[Episode] = []
    try:
        with display.job("making demonstrations", wanted * len(config.tasks)) as job:
            chooser = ExpertChooser(expert)
            for finished in play(browser, chooser, schedule, step_limit=config.step_limit, metrics=metrics):
                made += [episode for episode in finished if episode.outcome.success]
                job.advance(len(finished))
    finally:
        browser.close()
    return sorted(made, key=lambda episode: (episode.trajectory.task, episode.trajectory.seed))


def recorded(
    path: Path, tasks: Sequence[str], limit: int | None, collections: Sequence[str] | None, display: Display
) -> tuple[list[Episode], ImportReport]:
    """Human recordings of some tasks, at most `limit` clean ones of each; failures among them."""
    found = find_recordings(path, collections=collections)
    with display.job("reading recordings", sum(len(found.get(task, ())) for task in tasks)) as job:
        return import_recordings(path, tasks=tasks, limit=limit, collections=collections, on_file=job.advance)


def chosen(episodes: list[Episode], config: Config, where: str) -> list[Episode]:
    """The first `demos.per_task` successes of every task; ValueError for a task that has none."""
    kept: list[Episode] = []
    for task in config.tasks:
        mine = [e for e in episodes if e.trajectory.task == task and e.outcome.success]
        if not mine:
            have = sorted({e.trajectory.task for e in episodes})
            raise ValueError(f"{where} has no successful demonstration of {task!r}; it has {', '.join(have) or 'none'}")
        kept += mine[: config.demos.per_task]
    for episode in kept:
        episode.trajectory.check_learned()
    return kept
