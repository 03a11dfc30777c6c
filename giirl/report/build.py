"""One page of HTML about a run: its numbers, its curves and its episodes, from what its folder holds."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from giirl.report.element_rewards import EpisodeView, scale_of
from giirl.report.heatmap import Maps, draw_heat
from giirl.report.inspector import Inspector
from giirl.report.numbers import facts_of, lead_of, learning_group, result_lines, result_tables, success_group
from giirl.report.render import render, scale_view, strip_view
from giirl.run.evaluate import THESIS
from giirl.run.folder import RunFolder
from giirl.run.grid import layouts_of, open_run, reward_panels
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.config_file import changed, dump_config
from giirl_core.files import atomic_write
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import EpisodeSpec, Goal, Weights
from learner.checkpoint import latest_checkpoint


def report(folder: RunFolder, config: Config, out: Path, pages: int, command: str, display: Display) -> None:
    """Write the page about a run, with `pages` episodes a task. A run that is not finished gives what there is."""
    points, result = folder.points(), _result(folder)
    demonstrations = _demonstrations(folder, config, result)
    groups = [success_group(config, points, result, demonstrations), learning_group(points)] if points else []
    strips, words = _strips(folder, config, pages, display)
    scale = scale_of(config)
    text = render(
        "report.html",
        title=f"{folder.path.name}, a run of GIIRL",
        name=folder.path.name,
        lead=lead_of(config, points, result),
        facts=list(facts_of(config, points, result, sum(demonstrations.values()) or None).items()),
        changes=[one for one in changed(config) if not one.startswith("run=")],
        result_lines=result_lines(config, result),
        result_tables=result_tables(config, result, THESIS),
        maps=_maps(folder, config),
        groups=groups,
        strips=[(task, [strip_view(strip, scale) for strip in some]) for task, some in strips.items()],
        strips_words=words,
        scale=scale_view(scale) if ALGORITHMS[config.algorithm].has_learned_reward else None,
        settings=dump_config(config),
        command=command,
    )
    with atomic_write(out) as file:
        file.write(text.encode())


def inspect(
    folder: RunFolder, config: Config, spec: EpisodeSpec, goal: Goal | None, out: Path, command: str
) -> EpisodeView:
    """Write a page about one fresh page: what policy and reward make of it under its instruction and another."""
    checkpoint = latest_checkpoint(folder.checkpoints)
    with Inspector(config, *_weights(folder, config, checkpoint), Metrics()) as inspector:
        strip = inspector.page(spec, goal)
    scale, reward = scale_of(config), ALGORITHMS[config.algorithm].has_learned_reward
    if strip.frames[0].other is None:
        lead = "Its instruction names no element that another could stand in for; say one with --goal."
    else:
        lead = "As it opens, under its own instruction and under another."
    text = render(
        "inspect.html",
        title=f"{spec.task}, page {spec.seed}",
        strip=strip_view(strip, scale),
        lead=lead if reward else f"{lead} {_no_reward(config)}",
        scale=scale_view(scale) if reward else None,
        origin=f"{folder.path.name}, {checkpoint.name}",
        command=command,
    )
    with atomic_write(out) as file:
        file.write(text.encode())
    return strip


def _strips(
    folder: RunFolder, config: Config, pages: int, display: Display
) -> tuple[dict[str, list[EpisodeView]], str]:
    """Episodes by task, and what they are in words, or why there are none."""
    if config.world != "miniwob":
        return {}, ""
    try:
        checkpoint = latest_checkpoint(folder.checkpoints)
    except ValueError as error:
        return {}, f"None: {error}."
    strips: dict[str, list[EpisodeView]] = {task: [] for task in config.tasks}
    with (
        Inspector(config, *_weights(folder, config, checkpoint), Metrics()) as inspector,
        display.job("playing for the report", pages * len(config.tasks)) as job,
    ):
        for task in config.tasks:
            for strip in inspector.strips(task, pages):
                strips[task].append(strip)
                job.advance()
    words = [
        f"The greedy policy of {checkpoint.name} on the first {pages} pages a task that are kept for looking at: their "
        "seeds are used by no training, demonstration, evaluation or tuning, and none was left out. Beside each step, "
        "the same page under another instruction: one that names another element of it, or, where no other element "
        "could be meant, the instruction of another page of the task."
    ]
    if config.browser == "fake":
        words.append("The fake browser draws no screenshots: its elements are shown as boxes.")
    if not ALGORITHMS[config.algorithm].has_learned_reward:
        words.append(_no_reward(config))
    return strips, " ".join(words)


def _no_reward(config: Config) -> str:
    return f"There is no reward to draw: {config.algorithm} learns a policy alone."


def _weights(folder: RunFolder, config: Config, checkpoint: Path) -> tuple[Weights, Weights | None]:
    reward = folder.weights(checkpoint, "reward") if ALGORITHMS[config.algorithm].has_learned_reward else None
    return folder.weights(checkpoint, "policy"), reward


def _result(folder: RunFolder) -> dict[str, Any] | None:
    if not folder.result.exists():
        return None
    try:
        result: dict[str, Any] = json.loads(folder.result.read_text())
    except ValueError as error:
        raise ValueError(f"{folder.result} is damaged: {error}") from None
    return result


def _demonstrations(folder: RunFolder, config: Config, result: dict[str, Any] | None) -> dict[str, int]:
    """How many of each task."""
    if result is not None:
        return dict(result.get("demonstrations", {}))
    if not folder.demonstrations.exists():
        return {}
    tasks = [episode.trajectory.task for episode in folder.load_demonstrations()]
    return {task: tasks.count(task) for task in config.tasks}


def _maps(folder: RunFolder, config: Config) -> Maps | None:
    """A grid's learned reward on the first layout, under every instruction of the training."""
    if config.world != "gridcraft" or not ALGORITHMS[config.algorithm].has_learned_reward:
        return None
    if not folder.checkpoints.exists():
        return None
    learner = open_run(config, latest_checkpoint(folder.checkpoints)).learner
    layout = layouts_of(config.grid)[0]
    return draw_heat(layout, reward_panels(config, learner, layout, learner.pairs))
