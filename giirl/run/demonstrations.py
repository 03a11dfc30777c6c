"""Demonstrations: made by the scripted experts, read from a file, or imported from human recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from actors.agents import ExpertAgent, RandomAgent
from actors.browser import open_browser
from actors.rollouts import Schedule, play
from browser_farm.experts import expert
from browser_farm.human.recordings import ImportReport, find_recordings, import_recordings
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.goals import is_held_out
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Episode, Purpose
from giirl_core.wire.messages import read_episodes


def gather(config: Config, metrics: Metrics, display: Display) -> list[Episode]:
    """The demonstrations that a config asks for: successful ones, at most `demos.per_task` of each task, none of a
    goal that is held out; a share of them may then be spoiled. None at all where nothing would be learned from them."""
    if not ALGORITHMS[config.algorithm].needs_demonstrations and not config.policy.bc_warmup_updates:
        return []
    kept = chosen(*_offered(config, metrics, display), config)
    return spoil(kept, config, metrics, display) if config.demos.noise_fraction else kept


def _offered(config: Config, metrics: Metrics, display: Display) -> tuple[list[Episode], str]:
    """All there are, and where they are from."""
    if config.demos.source == "scripted":
        return make(config, metrics, display), "the scripted expert"
    if not config.demos.path:
        raise ValueError(f"demos.source is {config.demos.source!r}: wanted demos.path=FILE_OR_FOLDER beside it")
    path = Path(config.demos.path)
    if config.demos.source == "recordings":
        episodes, _ = recorded(path, config.tasks, config.demos.per_task, config.demos.collections or None, display)
    else:
        episodes = read_episodes(path)
    return episodes, str(path)


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
            chooser = ExpertAgent(expert)
            for finished in play(browser, chooser, schedule, step_limit=config.step_limit, metrics=metrics):
                made += [episode for episode in finished if episode.outcome.success]
                job.advance(len(finished))
    finally:
        browser.close()
    return sorted(made, key=lambda episode: (episode.trajectory.task, episode.trajectory.seed))


def recorded(
    path: Path, tasks: Sequence[str], limit: int | None, collections: Sequence[str] | None, display: Display
) -> tuple[list[Episode], ImportReport]:
    """Human recordings of some tasks, or of all there are, at most `limit` clean ones of each; failures among them."""
    found = find_recordings(path, collections=collections)
    wanted = tasks or list(found)
    with display.job("reading recordings", sum(len(found.get(task, ())) for task in wanted)) as job:
        return import_recordings(path, tasks=wanted, limit=limit, collections=collections, on_file=job.advance)


def spoil(kept: list[Episode], config: Config, metrics: Metrics, display: Display) -> list[Episode]:
    """Put episodes of chance in the place of each task's last ones, on other pages and whatever came of them."""
    bad = {
        task: round(config.demos.noise_fraction * sum(e.trajectory.task == task for e in kept)) for task in config.tasks
    }
    schedule = Schedule(
        config.tasks,
        config.actors.tabs,
        purpose=Purpose.DEMONSTRATE,
        run_seed=config.seed,
        first=config.demos.per_task,
        quota=math.ceil(max(bad.values()) / (1 - config.held_out_goals) * (2 if config.held_out_goals else 1)),
    )
    browser = open_browser(config, metrics)
    try:
        with display.busy("spoiling demonstrations"):
            rounds = play(browser, RandomAgent(), schedule, step_limit=config.step_limit, metrics=metrics)
            held_out = config.held_out_goals
            played = [e for some in rounds for e in some if not is_held_out(e.trajectory.goal, held_out)]
    finally:
        browser.close()
    mixed: list[Episode] = []
    for task, count in bad.items():
        good = [e for e in kept if e.trajectory.task == task]
        spoiled = [e for e in played if e.trajectory.task == task]
        spoiled.sort(key=lambda episode: episode.trajectory.seed)
        mixed += good[: len(good) - count] + spoiled[:count]
    return mixed


def chosen(episodes: list[Episode], where: str, config: Config) -> list[Episode]:
    """The first `demos.per_task` successes of every task; ValueError for a task that has none."""
    kept: list[Episode] = []
    for task in config.tasks:
        mine = [e for e in episodes if e.trajectory.task == task and e.outcome.success]
        mine = [e for e in mine if not is_held_out(e.trajectory.goal, config.held_out_goals)]
        if not mine:
            have = sorted({e.trajectory.task for e in episodes})
            raise ValueError(f"{where} has no successful demonstration of {task!r}; it has {', '.join(have) or 'none'}")
        kept += mine[: config.demos.per_task]
    for episode in kept:
        episode.trajectory.check_learned()
    return kept
