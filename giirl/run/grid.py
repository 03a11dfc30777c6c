"""A run in LanguageGridCraft, from config to result: no browser, no other processes, under a minute."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import torch
from rich.table import Column, Table

from giirl.figures import Panel, draw_maps
from giirl.run.folder import RunFolder
from giirl.run.grid_metrics import Measures, learned_tables, means, measure, policy_returns
from giirl.signals import Stopped, raise_if, stopping
from giirl_core.config import Config, GridConfig
from giirl_core.nets.parameters import hash_nets
from giirl_core.progress import Display
from gridcraft.instructions import ColourPair, ordered_pairs, plain_sentence
from gridcraft.layouts import Layout, named_layout, random_layout
from gridcraft.reward_metrics import state_mean
from gridcraft.world import build_world
from learner.algorithms import LOOPS
from learner.checkpoint import save_checkpoint
from learner.grid.learner import GridLearner
from learner.grid.steps import GridSource

PROGRESS = "grid.json"  # in a checkpoint
LATE = 2 / 3  # of a run; from here on `late_minimum` looks at the returns


@dataclass(slots=True, kw_only=True, eq=False)
class GridRun:
    """The state of a run in memory: what is trained, what plays, and the learning curve."""

    learner: GridLearner
    source: GridSource
    curve: list[dict[str, Any]]  # step, env_steps, returns by sentence, statistics of the updates
    cpu_s: float = 0.0  # of training, demonstrations and random episodes; not of measuring and saving

    @property
    def env_steps(self) -> int:
        """In all episodes that the learner trained on, the random ones included."""
        return self.learner.random_env_steps + self.source.env_steps

    @property
    def late_minimum(self) -> float:
        """The lowest measured return of any goal in the last third of the run."""
        last = self.curve[-1]["step"]
        late = [point["returns"].values() for point in self.curve if point["step"] > LATE * last]
        return float(min(min(returns) for returns in late))

    @property
    def mean_return(self) -> float:
        """The mean over goals at the last measurement; 0 before the first."""
        return float(np.mean(list(self.curve[-1]["returns"].values()))) if self.curve else 0.0

    def save(self, folder: Path) -> None:
        """Write a checkpoint into an empty folder."""
        self.learner.save(folder)
        (folder / PROGRESS).write_text(
            json.dumps({"played": self.source.env_steps, "cpu_s": self.cpu_s}), encoding="utf-8"
        )

    def load(self, folder: Path) -> None:
        """The inverse of `save`."""
        self.learner.load(folder)
        progress = json.loads((folder / PROGRESS).read_bytes())
        self.source.env_steps, self.cpu_s = progress["played"], progress["cpu_s"]


def layouts_of(grid: GridConfig) -> tuple[Layout, ...]:
    """The layouts that the config names, then its random layouts."""
    seeds = range(grid.layout_seed, grid.layout_seed + grid.random_layouts)
    named = tuple(named_layout(name) for name in grid.layouts)
    return named + tuple(random_layout(seed, colours=grid.colours) for seed in seeds)


def pairs_of(grid: GridConfig) -> tuple[ColourPair, ...]:
    """The pairs of colours (goal, avoid) to train on: all of the config, without the held-out ones."""
    held_out = {read_pair(text) for text in grid.held_out}
    every = tuple(read_pair(text) for text in grid.goals) or ordered_pairs(grid.colours)
    if unknown := held_out - set(every):
        raise ValueError(f"grid.held_out has {min(map(str, unknown))}, which is none of the {len(every)} goals")
    if not (kept := tuple(pair for pair in every if pair not in held_out)):
        raise ValueError("grid.held_out holds every goal out: wanted at least one to train on")
    return kept


def read_pair(text: str) -> ColourPair:
    """Parse "red-blue": go to red, avoid blue."""
    goal, dash, avoid = text.partition("-")
    if not dash:
        raise ValueError(f"{text!r} is not a pair of colours: wanted one like 'red-blue', go to red and avoid blue")
    return ColourPair(goal, avoid)


def open_run(config: Config, checkpoint: Path | None = None) -> GridRun:
    """A new run, or one as a checkpoint saved it."""
    torch.set_num_threads(1)  # the nets are small: more threads would only wait for each other
    since_s = time.process_time()
    world = build_world(layouts_of(config.grid))
    learner = GridLearner(config, world, pairs_of(config.grid))
    source = GridSource(world, learner.features, learner.goals, learner.behaviour_policy, learner.rng)
    run = GridRun(learner=learner, source=source, curve=[], cpu_s=time.process_time() - since_s)
    if checkpoint is not None:
        run.load(checkpoint)
    return run


def learn(config: Config) -> GridRun:
    """Train in memory from the first iteration to the last."""
    run = open_run(config)
    continue_run(config, run, lambda: None)
    return run


def continue_run(config: Config, run: GridRun, after_step: Callable[[], None], stop: Event | None = None) -> None:
    """Train a run from its current iteration to the last, and measure the policy every `grid.measure_every`.

    `after_step` is called after each iteration. Stopped when `stop` is set.
    """
    learner, began_s = run.learner, time.process_time()

    def steps() -> Iterator[int]:
        for step in range(learner.version, config.iterations):
            if stop is not None:
                raise_if(stop)
            learner.anneal(step)
            yield step

    def observe(step: int, stats: dict[str, float]) -> None:
        nonlocal began_s
        run.cpu_s += time.process_time() - began_s
        learner.version = step + 1
        if learner.version % config.grid.measure_every == 0 or learner.version == config.iterations:
            returns = [round(value, 6) for value in policy_returns(config, learner, run.source.world)]
            named = dict(zip(map(plain_sentence, learner.pairs), returns, strict=True))
            run.curve.append({"step": learner.version, "env_steps": run.env_steps, "returns": named, **stats})
        after_step()
        began_s = time.process_time()

    LOOPS[config.algorithm](config, learner, run.source, steps(), observe)


def train_grid(config: Config, folder: RunFolder, resume: Path | None, display: Display) -> dict[str, Any]:
    """Train, evaluate and draw the learned reward; returns the result.

    Raises Stopped after Ctrl-C, SIGTERM or SIGHUP, with a checkpoint saved.
    """
    since_s = time.monotonic()
    display.say(f"world {config.world}: {len(layouts_of(config.grid))} layouts, {len(pairs_of(config.grid))} goals")
    run, stop = open_run(config, resume), Event()
    folder.cut_curve(run.learner.version)
    run.curve = folder.points()
    if resume is None:
        _save(config, folder, run)  # now the run can be resumed
    with stopping(stop), display.job("training", config.iterations, run.learner.version) as job:

        def after_step() -> None:
            if run.curve and run.curve[-1]["step"] == run.learner.version:
                folder.append_curve(run.curve[-1])
            job.advance(1, f"return {run.mean_return:.3f} of optimal")
            if run.learner.version % config.checkpoint_every == 0 or run.learner.version == config.iterations:
                _save(config, folder, run)

        try:
            continue_run(config, run, after_step, stop)
        except Stopped:
            _save(config, folder, run)
            raise
    figure = folder.path / "reward.png"
    draw_rewards(figure, config, run.learner, layouts_of(config.grid)[0], run.learner.pairs[:2])
    display.say(f"heat map of the learned reward: {figure}")
    return {
        **evaluate_grid(config, run),
        "late_minimum": run.late_minimum,
        "seconds": round(time.monotonic() - since_s, 1),
    }


def evaluate_grid(config: Config, run: GridRun) -> dict[str, Any]:
    """The result of a run: policy and reward measured in the layouts and for the goals of the config."""
    return {
        **summary(measure(config, run.learner, layouts_of(config.grid), run.learner.pairs)),
        "env_steps": run.env_steps,
        "cpu_seconds": round(run.cpu_s, 2),
        "algorithm": config.algorithm,
        "seed": config.seed,
        "parameters_sha256": hash_nets(*run.learner.nets().values()),
    }


def _save(config: Config, folder: RunFolder, run: GridRun) -> None:
    save_checkpoint(folder.checkpoints, run.learner.version, run.save, keep=config.keep_checkpoints)


def summary(found: Sequence[Measures]) -> dict[str, Any]:
    """Returns by goal, and the means of all measures over goals and layouts."""
    goals = {}
    for pair in dict.fromkeys(one.pair for one in found):
        own = means([one for one in found if one.pair == pair])
        goals[plain_sentence(pair)] = {
            "return_over_optimal": own["policy"],
            "reoptimised_over_optimal": own["reoptimised"],
        }
    mean = means(found)
    return {
        "goals": goals,
        "mean_return_over_optimal": mean["policy"],
        "reoptimised_over_optimal": mean["reoptimised"],
        "epic": mean["epic"],
        "spearman": mean["spearman"],
        "pearson": mean["pearson"],
        "goal_sensitivity": mean["sensitivity"],
        "avoid": {
            "ranked_below_neutral": mean["avoid_rank"],
            "ranked_below_neutral_as_far_from_the_goal": mean["matched_avoid_rank"],
            "entered": mean["entered"],
            "expert_entered": mean["expert_entered"],
        },
    }


def grid_table(result: dict[str, Any]) -> Table:
    """A result as a table for the terminal."""
    table = Table("instruction", Column("return", justify="right"), Column("re-optimised", justify="right"))
    for goal, own in result["goals"].items():
        table.add_row(goal, f"{own['return_over_optimal']:.3f}", f"{own['reoptimised_over_optimal']:.3f}")
    numbers = f"Spearman {result['spearman']:.2f}, Pearson {result['pearson']:.2f}, EPIC {result['epic']:.2f}"
    table.caption = f"1 is optimal, 0 random. Learned reward: {numbers}"
    return table


def draw_rewards(path: Path, config: Config, learner: GridLearner, layout: Layout, pairs: Sequence[ColourPair]) -> None:
    """Draw the map and the state-mean learned reward under each sentence (figure 4.3 of the thesis)."""
    draw_maps(path, layout, reward_panels(config, learner, layout, pairs))


def reward_panels(config: Config, learner: GridLearner, layout: Layout, pairs: Sequence[ColourPair]) -> list[Panel]:
    """The state-mean learned reward [H, W] on a layout under each sentence."""
    world = build_world([layout])
    panels = []
    for pair in pairs:
        score = np.full(layout.cells.shape, np.nan)
        score[tuple(world.position.T)] = state_mean(learned_tables(config, learner, world, pair).reward)
        panels.append(Panel(title=plain_sentence(pair), values=score))
    return panels
