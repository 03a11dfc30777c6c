"""A run in LanguageGridCraft, from settings to measures: no browser, no processes, under a minute."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.table import Column, Table

from giirl.config import Config, GridConfig
from giirl.figures import Panel, draw_maps
from giirl.gridcraft import build_world
from giirl.gridcraft_instructions import Pair, ordered_pairs, plain_sentence
from giirl.gridcraft_layouts import Layout, named_layout, random_layout
from giirl.parameters import hash_nets
from giirl.progress import Display, Job
from giirl.reward_measures import state_mean
from giirl.run_folder import RunFolder
from giirl.run_grid_measures import Measures, learned_tables, means, measure, policy_fractions
from learner.algorithms import clone
from learner.giirl import giirl
from learner.grid_steps import GridSource
from learner.gridworld import GridLearner

LATE = 2 / 3  # of a run: from here on the policy may not get worse again


@dataclass(slots=True, kw_only=True, eq=False)
class GridRun:
    """What came out of learning."""

    learner: GridLearner
    curve: list[dict[str, Any]]  # step, env_steps, returns by sentence, and what the updates told
    env_steps: int
    cpu_s: float  # of learning, demonstrations and chance's episodes included, measuring not

    @property
    def late_minimum(self) -> float:
        """The worst goal's worst measured return in the last third of the run."""
        last = self.curve[-1]["step"]
        late = [point["returns"].values() for point in self.curve if point["step"] > LATE * last]
        return float(min(min(returns) for returns in late))


def layouts_of(grid: GridConfig) -> tuple[Layout, ...]:
    """The layouts that the config names, then its random ones."""
    seeds = range(grid.layout_seed, grid.layout_seed + grid.random_layouts)
    named = tuple(named_layout(name) for name in grid.layouts)
    return named + tuple(random_layout(seed, colours=grid.colours) for seed in seeds)


def pairs_of(grid: GridConfig) -> tuple[Pair, ...]:
    """The pairs that training sees."""
    held = {read_pair(text) for text in grid.held_out}
    every = tuple(read_pair(text) for text in grid.goals) or ordered_pairs(grid.colours)
    if strange := held - set(every):
        raise ValueError(f"grid.held_out has {min(map(str, strange))}, which is none of the {len(every)} goals")
    if not (kept := tuple(pair for pair in every if pair not in held)):
        raise ValueError("grid.held_out holds every goal out: wanted at least one to learn from")
    return kept


def read_pair(text: str) -> Pair:
    """`red-blue`: go to red, avoid blue."""
    goal, dash, avoid = text.partition("-")
    if not dash:
        raise ValueError(f"{text!r} is no pair of colours, wanted one like 'red-blue': go to red, avoid blue")
    return Pair(goal, avoid)


def learn(config: Config, job: Job | None = None) -> GridRun:
    """Algorithm 1, or cloning, for `iterations` steps; the policy is measured every `grid.measure_every`."""
    torch.set_num_threads(1)  # the nets are small: more threads only wait for each other
    since_s = time.process_time()
    world = build_world(layouts_of(config.grid))
    learner = GridLearner(config, world, pairs_of(config.grid))
    source = GridSource(world, learner.sight, learner.goals, learner.acting, learner.rng)
    run = GridRun(learner=learner, curve=[], env_steps=learner.chance_env_steps, cpu_s=0.0)
    measured_s, mean = 0.0, 0.0

    def observe(step: int, stats: dict[str, float]) -> None:
        nonlocal measured_s, mean
        begun_s = time.process_time()
        run.env_steps = learner.chance_env_steps + source.env_steps
        learner.accuracy = stats.get("d_accuracy_rollouts", learner.accuracy)
        if (step + 1) % config.grid.measure_every == 0 or step + 1 == config.iterations:
            returns = [round(got, 6) for got in policy_fractions(config, learner, world)]
            named = dict(zip(map(plain_sentence, learner.pairs), returns, strict=True))
            mean = float(np.mean(returns))
            run.curve.append({"step": step + 1, "env_steps": run.env_steps, "returns": named, **stats})
        if job is not None:
            job.advance(1, f"return {mean:.3f} of optimal")
        measured_s += time.process_time() - begun_s

    algorithm = clone if config.algorithm == "cloning" else giirl
    algorithm(config, learner, source, _steps(config, learner), observe)
    run.cpu_s = time.process_time() - since_s - measured_s
    return run


def _steps(config: Config, learner: GridLearner) -> Iterator[int]:
    for step in range(config.iterations):
        learner.anneal(step)
        yield step


def train_grid(config: Config, folder: RunFolder, display: Display) -> dict[str, Any]:
    """Learn, measure and draw the first figure into the run's folder."""
    since_s = time.monotonic()
    display.say(f"world {config.world}: {len(layouts_of(config.grid))} layouts, {len(pairs_of(config.grid))} goals")
    with display.job("training", config.iterations) as job:
        run = learn(config, job)
    for point in run.curve:
        folder.append_curve(point)
    layouts = layouts_of(config.grid)
    found = measure(config, run.learner, layouts, run.learner.pairs)
    figure = folder.path / "reward.png"
    draw_rewards(figure, config, run.learner, layouts[0], run.learner.pairs[:2])
    display.say(f"the learned reward, drawn: {figure}")
    return {
        **summary(found),
        "late_minimum": run.late_minimum,
        "env_steps": run.env_steps,
        "cpu_seconds": round(run.cpu_s, 2),
        "seconds": round(time.monotonic() - since_s, 1),
        "algorithm": config.algorithm,
        "seed": config.seed,
        "parameters_sha256": hash_nets(*run.learner.nets().values()),
    }


def summary(found: Sequence[Measures]) -> dict[str, Any]:
    """Measures by goal, and their means over goals and layouts."""
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
        "avoid": {
            "ranked_below_neutral": mean["avoid_rank"],
            "ranked_below_neutral_as_far_from_the_goal": mean["matched_avoid_rank"],
            "entered": mean["entered"],
            "expert_entered": mean["expert_entered"],
        },
    }


def grid_table(result: dict[str, Any]) -> Table:
    """The result, for a person."""
    table = Table("instruction", Column("return", justify="right"), Column("re-optimised", justify="right"))
    for goal, own in result["goals"].items():
        table.add_row(goal, f"{own['return_over_optimal']:.3f}", f"{own['reoptimised_over_optimal']:.3f}")
    numbers = f"Spearman {result['spearman']:.2f}, Pearson {result['pearson']:.2f}, EPIC {result['epic']:.2f}"
    table.caption = f"1 is optimal, 0 chance. The reward: {numbers}"
    return table


def draw_rewards(path: Path, config: Config, learner: GridLearner, layout: Layout, pairs: Sequence[Pair]) -> None:
    """The true map, and the state-mean learned reward under each sentence: figure 4.3 of the thesis."""
    world = build_world([layout])
    panels = []
    for pair in pairs:
        score = np.full(layout.cells.shape, np.nan)
        score[tuple(world.position.T)] = state_mean(learned_tables(config, learner, world, pair).reward)
        panels.append(Panel(title=plain_sentence(pair), values=score))
    draw_maps(path, layout, panels)
