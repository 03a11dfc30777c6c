"""The figures of the tabular chapter: trained, measured and drawn, with one result each."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from giirl.figures import draw_returns
from giirl.run.grid import GridRun, draw_rewards, layouts_of, learn, summary
from giirl.run.grid_metrics import measure
from giirl.studies.grid_settings import thesis
from giirl_core.config import Config
from giirl_core.progress import Display
from gridcraft.instructions import ColourPair, plain_sentence

SENTENCES = (ColourPair("green", "blue"), ColourPair("red", "blue"))  # of figure 4.3


def figure_4_3(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """The map and the learned reward under two sentences: drawn for the first seed, measured for all."""
    runs = learn_all("figure 4.3", [thesis(seed) for seed in range(seeds)], display)
    layouts = layouts_of(thesis().grid)
    drawn = out / "figure-4.3.png"
    draw_rewards(drawn, thesis(0), runs[0].learner, layouts[0], SENTENCES)
    found = [one for seed, run in enumerate(runs) for one in measure(thesis(seed), run.learner, layouts, SENTENCES)]
    return {**summary(found), "figure": str(drawn), "seeds": seeds}


def figure_4_4(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """Return against environment steps for every goal of the grid, with a band over the seeds."""
    runs = learn_all("figure 4.4", [thesis(seed) for seed in range(seeds)], display)
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


def learn_all(what: str, configs: Sequence[Config], display: Display) -> list[GridRun]:
    """Train one run for each config."""
    runs = []
    with display.job(what, len(configs)) as job:
        for config in configs:
            runs.append(learn(config))
            job.advance(1, f"return {np.mean(list(runs[-1].curve[-1]['returns'].values())):.3f} of optimal")
    return runs
