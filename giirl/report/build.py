"""Write the HTML report of a run from its folder: results, training curves and episodes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from giirl.report.element_rewards import EpisodeView, scale_of
from giirl.report.inspector import Inspector
from giirl.report.numbers import facts_of, flow_group, lead_of, learning_group, no_reward, weights_of
from giirl.report.render import render, scale_view, strip_view
from giirl.report.worlds import report_of
from giirl.run.folder import RunFolder
from giirl.statistics import percent
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.config_file import changed, dump_config
from giirl_core.files import atomic_write
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import EpisodeSpec, Goal

UNFINISHED = "The run is not finished, so it has no evaluation result."


def report(folder: RunFolder, config: Config, out: Path, pages: int, command: str, display: Display) -> None:
    """Write the report of a run, with `pages` episodes per task. An unfinished run gives a report without results."""
    points, result = folder.points(), _result(folder)
    demonstrations = _demonstrations(folder, config, result)
    world = report_of(config)
    groups = []
    if points:
        success = world.success_group(config, points, result, demonstrations)
        groups = [success, learning_group(points), *flow_group(points)]
    facts = facts_of(config, points, result, sum(demonstrations.values()) or None)
    strips, words = world.strips(folder, config, pages, display)
    scale = scale_of(config)
    text = render(
        "report.html",
        title=f"{folder.path.name}: GIIRL run report",
        name=folder.path.name,
        lead=lead_of(config, world.subject(config), points, result),
        facts=list({**facts, **world.facts(config)}.items()),
        changes=[one for one in changed(config) if not one.startswith("run=")],
        result_lines=world.result_lines(result) if result else [UNFINISHED],
        result_tables=world.result_tables(result) if result else [],
        maps=world.maps(folder, config),
        groups=groups,
        strips=[
            (title, [strip_view(strip, scale) for strip in strips[task]])
            for task, title in _lowest_first(strips, result).items()
        ],
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
    """Write a report about one page: policy and reward under its own instruction and under another one."""
    checkpoint = folder.latest_checkpoint()
    with Inspector(config, *weights_of(folder, config, checkpoint), Metrics()) as inspector:
        strip = inspector.page(spec, goal)
    scale, reward = scale_of(config), ALGORITHMS[config.algorithm].has_learned_reward
    if strip.frames[0].other is None:
        lead = "No goal swap: no other element fits this instruction. Pass another instruction with --goal."
    else:
        lead = "The first step of the page, under its own instruction and under another one (goal swap)."
    text = render(
        "inspect.html",
        title=f"{spec.task}, page {spec.seed}",
        strip=strip_view(strip, scale),
        lead=lead if reward else f"{lead} {no_reward(config)}",
        scale=scale_view(scale) if reward else None,
        origin=f"{folder.path.name}, {checkpoint.name}",
        command=command,
    )
    with atomic_write(out) as file:
        file.write(text.encode())
    return strip


def _result(folder: RunFolder) -> dict[str, Any] | None:
    if not folder.result.exists():
        return None
    try:
        result: dict[str, Any] = json.loads(folder.result.read_bytes())
    except ValueError as error:
        raise ValueError(f"{folder.result} is damaged: {error}") from None
    return result


def _lowest_first(strips: Mapping[str, Any], result: Mapping[str, Any] | None) -> dict[str, str]:
    """The title of each task with its success, the lowest first; in the order of the settings without a result."""
    success = {task: row["success"] for task, row in (result or {}).get("tasks", {}).items()}
    known = [task for task in strips if success.get(task) is not None]
    titles = {task: f"{task}, {percent(success[task])} %" for task in sorted(known, key=lambda task: success[task])}
    return titles | {task: task for task in strips if task not in titles}


def _demonstrations(folder: RunFolder, config: Config, result: dict[str, Any] | None) -> dict[str, int]:
    """The number of demonstrations per task."""
    if result is not None:
        return dict(result.get("demonstrations", {}))
    if not folder.demonstrations.exists():
        return {}
    tasks = [episode.trajectory.task for episode in folder.load_demonstrations()]
    return {task: tasks.count(task) for task in config.tasks}
