"""Demonstrations of a run: played by the scripted experts, read from a file, or imported from human recordings."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from actors.player import AgentSpec, OpenPlayer, open_browser_player
from actors.workflows import workflow_of
from browser_farm.human.recording_files import find_recordings
from browser_farm.human.recordings import ImportReport, import_recordings
from browser_farm.mixed import expert_of
from giirl.statistics import missing_pages
from giirl_core.algorithms import ALGORITHMS
from giirl_core.choices import shown_gestures
from giirl_core.config import Config
from giirl_core.config.sections import SHOWN
from giirl_core.gestures import BASIC, MAX_GESTURES, read_gestures
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Episode, Purpose, Trajectory, is_held_out
from giirl_core.wire.messages import read_sound_episodes


def collect_demonstrations(
    config: Config, metrics: Metrics, display: Display, open_player: OpenPlayer = open_browser_player
) -> tuple[Config, list[Episode]]:
    """The demonstrations of a run: for each task the first `demos.per_task` successes whose goal is not held out.

    `demos.noise_fraction` of them are then replaced by random episodes. The list is empty for an algorithm that does
    not learn from demonstrations. In the config that comes with them, `net.gestures` has what they show, and so has
    `demos.workflows` with `algorithm=wge`.
    """
    imitates = config.policy.bc_warmup_updates or config.policy.cloning_updates
    if not ALGORITHMS[config.algorithm].needs_demonstrations and not imitates:
        return with_shown_gestures(config, []), []
    episodes, origin = _read_source(config, metrics, display, open_player)
    config, kept = select(episodes, origin, config, display)
    if config.algorithm == "wge":
        config = with_shown_workflows(config, [episode.trajectory for episode in kept])
    return config, add_noise(kept, config, metrics, display, open_player) if config.demos.noise_fraction else kept


def _read_source(
    config: Config, metrics: Metrics, display: Display, open_player: OpenPlayer
) -> tuple[list[Episode], str]:
    """All episodes of the config's source and of `demos.scripted_tasks`, and the name of the source for errors."""
    for task in config.demos.scripted_tasks:
        expert_of(task)  # a wrong name is an error
    scripted = config.tasks if config.demos.source == "scripted" else config.demos.scripted_tasks
    made, recorded = (tuple(t for t in config.tasks if (t in scripted) is wanted) for wanted in (True, False))
    read, origin = _read(replace(config, tasks=recorded), display) if recorded else ([], "the scripted expert")
    return read + (make(replace(config, tasks=made), metrics, display, open_player) if made else []), origin


def _read(config: Config, display: Display) -> tuple[list[Episode], str]:
    """The episodes of a file or a folder of recordings, and its name."""
    if not config.demos.path:
        raise ValueError(f"demos.source is {config.demos.source!r} and demos.path is empty: wanted a file or folder")
    path = Path(config.demos.path)
    if config.demos.source == "recordings":
        collections = config.demos.collections or None
        episodes, report = import_folder(path, config.tasks, config.demos.per_task, collections, display)
        unreadable = report.unreadable
    else:
        episodes, unreadable = read_sound_episodes(path)
    if unreadable:
        display.say(f"{path}: {left_out(unreadable)}; the others are used")
    return episodes, str(path)


def left_out(unreadable: Sequence[str]) -> str:
    """How many demonstrations of a source cannot be read, and what is wrong with the first."""
    return f"{len(unreadable)} cannot be read, the first is {unreadable[0]}"


def make(
    config: Config, metrics: Metrics, display: Display, open_player: OpenPlayer = open_browser_player
) -> list[Episode]:
    """Successful episodes of the scripted experts, on pages that training and evaluation never use."""
    for task in config.tasks:
        expert_of(task)  # a task without an expert is an error before a browser starts
    pages = config.demos.per_task
    with (
        open_player(config, metrics) as player,
        display.job("making demonstrations", pages * len(config.tasks)) as job,
    ):
        played = player.play(AgentSpec(kind="expert"), Purpose.DEMONSTRATE, pages, job=job)
    counts = Counter(episode.trajectory.task for episode in played)
    rows = {task: {"episodes": counts[task], "missing": pages - counts[task]} for task in config.tasks}
    if missing := missing_pages(rows):
        display.say(missing)
    won = [episode for episode in played if episode.outcome.success]
    return sorted(won, key=lambda episode: (episode.trajectory.task, episode.trajectory.seed))


def import_folder(
    path: Path, tasks: Sequence[str], limit: int | None, collections: Sequence[str] | None, display: Display
) -> tuple[list[Episode], ImportReport]:
    """Human recordings of `tasks`, or of every task in the folder when that is empty.

    At most `limit` recordings without errors of each task; failed episodes are among them.
    """
    found = find_recordings(path, collections=collections)
    wanted = tasks or list(found)
    with display.job("reading recordings", sum(len(found.get(task, ())) for task in wanted)) as job:
        return import_recordings(path, tasks=wanted, limit=limit, collections=collections, on_file=job.advance)


def add_noise(
    kept: list[Episode], config: Config, metrics: Metrics, display: Display, open_player: OpenPlayer
) -> list[Episode]:
    """Replace the last `demos.noise_fraction` of each task by episodes of the random policy on other pages.

    Their outcomes do not matter. Enough pages are played that some remain when goals are held out.
    """
    noisy = {
        task: round(config.demos.noise_fraction * sum(e.trajectory.task == task for e in kept)) for task in config.tasks
    }
    spare = 2 if config.held_out_goals else 1
    pages = math.ceil(max(noisy.values()) / (1 - config.held_out_goals) * spare)
    with (
        open_player(config, metrics) as player,
        display.job("making noisy demonstrations", pages * len(config.tasks)) as job,
    ):
        first = config.demos.per_task
        played = player.play(AgentSpec(kind="random"), Purpose.DEMONSTRATE, pages, first=first, job=job)
    played = [e for e in played if not is_held_out(e.trajectory.goal, config.held_out_goals)]
    mixed: list[Episode] = []
    for task, count in noisy.items():
        good = [e for e in kept if e.trajectory.task == task]
        random = [e for e in played if e.trajectory.task == task]
        random.sort(key=lambda episode: episode.trajectory.seed)
        mixed += good[: len(good) - count] + random[:count]
    return mixed


def with_shown_gestures(config: Config, demonstrations: Sequence[Trajectory]) -> Config:
    """The config with what demonstrations show in place of SHOWN in `net.gestures`."""
    if SHOWN not in config.net.gestures:
        return config
    listed = [text for text in config.net.gestures if text != SHOWN]
    shown = shown_gestures(list(zip(one.actions, one.pages, strict=True)) for one in demonstrations)
    gestures = tuple(dict.fromkeys((*listed, *shown)))[: MAX_GESTURES - len(BASIC)]
    return replace(config, net=replace(config.net, gestures=gestures))


def with_shown_workflows(config: Config, demonstrations: Sequence[Trajectory]) -> Config:
    """The config with the workflows of demonstrations in place of SHOWN in `demos.workflows`."""
    if SHOWN not in config.demos.workflows:
        return config
    listed = [text for text in config.demos.workflows if text != SHOWN]
    gestures = read_gestures(config.net.gestures)
    shown = [str(workflow_of(demonstration, gestures)) for demonstration in demonstrations]
    return replace(config, demos=replace(config.demos, workflows=tuple(dict.fromkeys((*listed, *shown)))))


def select(episodes: list[Episode], origin: str, config: Config, display: Display) -> tuple[Config, list[Episode]]:
    """The first `demos.per_task` successes of every task that the nets can learn; ValueError for a task without any.

    `net.gestures` of the config that comes with them has what the first successes show.
    """
    won: dict[str, list[Episode]] = {}
    for task in config.tasks:
        good = [e for e in episodes if e.trajectory.task == task and e.outcome.success]
        won[task] = [e for e in good if not is_held_out(e.trajectory.goal, config.held_out_goals)]
        if not won[task]:
            have = ", ".join(sorted({e.trajectory.task for e in episodes})) or "none"
            raise ValueError(f"{origin} has no successful demonstration of {task!r}; it has {have}")
    first = [episode.trajectory for good in won.values() for episode in good[: config.demos.per_task]]
    config = with_shown_gestures(config, first)
    gestures = read_gestures(config.net.gestures)
    kept: list[Episode] = []
    unlearnable: list[str] = []
    for good in won.values():
        reasons = [episode.trajectory.unlearnable(gestures) for episode in good]
        learnable = [episode for episode, why in zip(good, reasons, strict=True) if not why]
        unlearnable += filter(None, reasons)
        if not learnable:
            raise ValueError(unlearnable[-1])
        kept += learnable[: config.demos.per_task]
    if config.net.gestures:
        display.say(f"gestures that the policy learns besides click and type words: {', '.join(config.net.gestures)}")
    if unlearnable:
        display.say(f"{origin}: {len(unlearnable)} demonstrations are left out, the first because {unlearnable[0]}")
    return config, kept
