"""The tabular chapter again, figure by figure: learned, measured, drawn, and put into one JSON each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from giirl.config import Config
from giirl.figures import draw_returns
from giirl.grid_settings import UNSEEN_LAYOUT_SEED, UNSEEN_PAIRS, few, held_out_pairs, joint, thesis
from giirl.gridcraft import build_world, true_reward
from giirl.gridcraft_instructions import Pair, plain_sentence
from giirl.gridcraft_layouts import Layout, random_layout
from giirl.progress import Display
from giirl.run_grid import GridRun, draw_rewards, layouts_of, learn, read_pair, summary
from giirl.run_grid_fresh import steps_to_optimal
from giirl.run_grid_measures import Measures, learned_tables, means, measure

SENTENCES = (Pair("green", "blue"), Pair("red", "blue"))  # those of figure 4.3
CLONING_UPDATES = 1000
FRESH_ITERATIONS = 150
DEMONSTRATIONS = (1, 3, 10)  # per layout and goal
SCALES = (0.1, 1.0, 10.0)  # of the true reward, in units of the learned one's clip


def figure_4_3(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """The map and the learned reward under two sentences, drawn for the first seed, measured for every one."""
    runs = _learn_all("figure 4.3", [thesis(seed) for seed in range(seeds)], display)
    layouts = layouts_of(thesis().grid)
    drawn = out / "figure-4.3.png"
    draw_rewards(drawn, thesis(0), runs[0].learner, layouts[0], SENTENCES)
    found = [one for seed, run in enumerate(runs) for one in measure(thesis(seed), run.learner, layouts, SENTENCES)]
    return {**summary(found), "figure": str(drawn), "seeds": seeds}


def figure_4_4(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """Return against steps for every goal of the grid, a band over the seeds."""
    runs = _learn_all("figure 4.4", [thesis(seed) for seed in range(seeds)], display)
    layouts = layouts_of(thesis().grid)
    found = [measure(thesis(seed), run.learner, layouts, run.learner.pairs) for seed, run in enumerate(runs)]
    env_steps = np.array([point["env_steps"] for point in runs[0].curve])
    goals = [plain_sentence(pair) for pair in runs[0].learner.pairs]
    curves = {goal: np.array([[point["returns"][goal] for point in run.curve] for run in runs]) for goal in goals}
    drawn = out / "figure-4.4.png"
    draw_returns(drawn, env_steps, curves)
    result = summary([one for some in found for one in some])
    for number, goal in enumerate(goals):
        result["goals"][goal]["lowest"] = min(some[number].policy for some in found)
    return {
        **result,
        "late_minimum": min(run.late_minimum for run in runs),
        "reoptimised_lowest": min(one.reoptimised for some in found for one in some),
        "env_steps": max(run.env_steps for run in runs),
        "cpu_seconds": round(float(np.mean([run.cpu_s for run in runs])), 2),
        "figure": str(drawn),
        "seeds": seeds,
    }


def gridcraft_joint(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """Many layouts and goals at once; what carries over to layouts and pairs never seen."""
    unseen = [random_layout(UNSEEN_LAYOUT_SEED + number) for number in range(joint().grid.random_layouts)]
    configs = [joint(seed) for seed in range(seeds)]
    runs = _learn_all("joint", configs, display, clone=True)
    seen_found = [one for c, r in zip(configs, runs, strict=True) for one in _measured(c, r, layouts_of(c.grid))]
    unseen_found = [one for c, r in zip(configs, runs, strict=True) for one in _measured(c, r, unseen)]
    drawn = out / "gridcraft-joint.png"
    draw_rewards(drawn, configs[0], runs[0].learner, unseen[0], SENTENCES)
    result = summary(seen_found)
    result["unseen_layouts"] = _carried(unseen_found)
    result["unseen_pairs"] = _unseen_pairs(seeds, display)
    result["demonstrations"] = {str(count): _few(seeds, count, unseen, display) for count in DEMONSTRATIONS}
    fresh = _shaped_against_sparse(seeds, display)
    result["steps_to_optimal"] = {
        "learned": [one["learned"] for one in fresh],
        "sparse": [one["sparse"] for one in fresh],
        "sparse_scales": list(SCALES),
    }
    return {
        **result,
        "env_steps": max(run.env_steps for run in runs),
        "cpu_seconds": round(float(np.mean([run.cpu_s for run in runs])), 2),
        "figure": str(drawn),
        "seeds": seeds,
    }


def _learn_all(what: str, configs: Sequence[Config], display: Display, *, clone: bool = False) -> list[GridRun]:
    runs = []
    with display.job(what, len(configs)) as job:
        for config in configs:
            runs.append(learn(config))
            if clone:
                _clone(runs[-1])
            job.advance(1, f"return {np.mean(list(runs[-1].curve[-1]['returns'].values())):.3f} of optimal")
    return runs


def _unseen_pairs(seeds: int, display: Display) -> dict[str, float]:
    """Four colours, what was learned from 8 of their ordered pairs measured on the other 4."""
    configs = [held_out_pairs(seed) for seed in range(seeds)]
    runs = _learn_all("unseen pairs", configs, display, clone=True)
    pairs = [read_pair(text) for text in UNSEEN_PAIRS]
    return _carried(
        [one for c, r in zip(configs, runs, strict=True) for one in measure(c, r.learner, layouts_of(c.grid), pairs)]
    )


def _few(seeds: int, demonstrations: int, unseen: Sequence[Layout], display: Display) -> dict[str, float]:
    """The reward re-optimised on unseen layouts, and cloning there, from so few demonstrations."""
    configs = [few(seed, demonstrations) for seed in range(seeds)]
    runs = _learn_all(f"{demonstrations} demonstrations", configs, display, clone=True)
    carried = _carried([one for c, r in zip(configs, runs, strict=True) for one in _measured(c, r, unseen)])
    return {"giirl": carried["reward_reoptimised"], "policy": carried["policy"], "cloning": carried["cloning"]}


def _clone(run: GridRun) -> None:
    """Cloning's figure, from the same demonstrations and a net of the same shape."""
    for _ in range(CLONING_UPDATES):
        run.learner.cloner.update(run.learner.demos.sample(run.learner.config.cloning.batch))


def _measured(config: Config, run: GridRun, layouts: Sequence[Layout]) -> list[Measures]:
    return list(measure(config, run.learner, layouts, run.learner.pairs))


def _carried(found: Sequence[Measures]) -> dict[str, float]:
    mean = means(found)
    return {"reward_reoptimised": mean["reoptimised"], "policy": mean["policy"], "cloning": mean["cloning"]}


def _shaped_against_sparse(seeds: int, display: Display) -> list[dict[str, Any]]:
    """Steps to optimal of fresh learners on the thesis's layout: on the learned reward, and on the true one scaled."""
    configs = [thesis(seed) for seed in range(seeds)]
    runs = _learn_all("shaped against sparse", configs, display)
    found = []
    for config, run in zip(configs, runs, strict=True):
        world, learner, clip = build_world(layouts_of(config.grid)), run.learner, config.discriminator.clip
        learned = [learned_tables(config, learner, world, pair).reward for pair in learner.pairs]
        true = [true_reward(world, pair) * clip for pair in learner.pairs]
        sparse = [
            steps_to_optimal(config, learner, world, [scale * r for r in true], most_iterations=FRESH_ITERATIONS)
            for scale in SCALES
        ]
        shaped = steps_to_optimal(config, learner, world, learned, most_iterations=FRESH_ITERATIONS)
        found.append({"learned": shaped, "sparse": sparse})
    return found
