"""Ablations of the method in the thesis's setting, and fresh learners on the learned and on the true reward."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Column, Table

from giirl.run.grid import layouts_of, summary
from giirl.run.grid_metrics import learned_tables, measure
from giirl.studies.grid_figures import learn_all
from giirl.studies.grid_fresh import steps_to_optimal
from giirl.studies.grid_settings import ABLATIONS, ablated, thesis
from giirl_core.progress import Display
from gridcraft.world import build_world, true_reward

FRESH_ITERATIONS = 150
SCALES = (0.1, 1.0, 10.0)  # factors of the true reward, in units of the learned reward's clip


def gridcraft_ablations(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """A row for each part of the method that is left out or replaced: means and worst cases over seeds and goals."""
    rows = {}
    for name in ABLATIONS:
        configs = [ablated(seed, name) for seed in range(seeds)]
        runs = learn_all(name, configs, display)
        layouts = layouts_of(configs[0].grid)
        found = [
            one for c, r in zip(configs, runs, strict=True) for one in measure(c, r.learner, layouts, r.learner.pairs)
        ]
        result = summary(found)
        rows[name] = {
            "return_over_optimal": result["mean_return_over_optimal"],
            "late_minimum": min(run.late_minimum for run in runs),
            "reoptimised_over_optimal": result["reoptimised_over_optimal"],
            "reoptimised_lowest": min(one.reoptimised for one in found),
            "spearman": result["spearman"],
            "pearson": result["pearson"],
            "epic": result["epic"],
            "avoid_ranked_below_neutral": result["avoid"]["ranked_below_neutral"],
        }
    display.table(_table(rows))
    return {"ablations": rows, "steps_to_optimal": shaped_against_sparse(seeds, display), "seeds": seeds}


def _table(rows: dict[str, dict[str, float]]) -> Table:
    names = ("policy", "late minimum", "re-optimised", "worst", "Spearman", "Pearson", "EPIC", "avoid rank")
    table = Table("", *(Column(name, justify="right") for name in names))
    for row, values in rows.items():
        table.add_row(row, *(f"{value:.3f}" for value in values.values()))
    return table


def shaped_against_sparse(seeds: int, display: Display) -> dict[str, Any]:
    """Environment steps until fresh learners are optimal, on each seed's learned reward and on the scaled true one."""
    configs = [thesis(seed) for seed in range(seeds)]
    runs = learn_all("rewards to freeze", configs, display)
    learned, sparse = [], []
    with display.job("fresh learners", seeds) as job:
        for config, run in zip(configs, runs, strict=True):
            world, learner, clip = build_world(layouts_of(config.grid)), run.learner, config.discriminator.clip
            frozen = [learned_tables(config, learner, world, pair).reward for pair in learner.pairs]
            true = [true_reward(world, pair) * clip for pair in learner.pairs]
            rewards = [frozen, *([scale * r for r in true] for scale in SCALES)]
            shaped, *others = (
                steps_to_optimal(config, learner, world, some, max_iterations=FRESH_ITERATIONS) for some in rewards
            )
            learned.append(shaped)
            sparse.append(others)
            job.advance(1, f"{shaped} steps on the learned reward, {others} on the true one")
    return {"learned": learned, "sparse": sparse, "sparse_scales": list(np.array(SCALES) * thesis().discriminator.clip)}
