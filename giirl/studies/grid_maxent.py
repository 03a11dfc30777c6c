"""The baseline that knows the dynamics, in the setting of the joint study: same layouts, goals and demonstrations."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from giirl.run.grid import layouts_of, open_run, summary
from giirl.run.grid_metrics import Measures, means, measure
from giirl.studies.grid_settings import UNSEEN_LAYOUT_SEED, joint
from giirl_core.progress import Display
from gridcraft.layouts import random_layout
from learner.grid.maxent import MaxEnt
from learner.schedules import linear_decay

UPDATES = 120
LEARNING_RATE, FINAL_FRACTION = 3e-3, 0.1  # chosen on seed 100 and layouts from 5000 on


def gridcraft_maxent(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """Maximum-entropy inverse reinforcement learning on trained and on unseen layouts."""
    del out  # it draws nothing
    unseen = [random_layout(UNSEEN_LAYOUT_SEED + number) for number in range(joint().grid.random_layouts)]
    own: list[Measures] = []
    others: list[Measures] = []
    began_s = time.process_time()
    with display.job("maximum entropy", seeds * UPDATES) as job:
        for seed in range(seeds):
            config = joint(seed)
            run = open_run(config)
            learner = run.learner
            baseline = MaxEnt(run.source.world, learner.features, learner.demos.steps, width=config.net.width)
            for update in range(UPDATES):
                rate = linear_decay(LEARNING_RATE, FINAL_FRACTION, update / UPDATES)
                job.advance(note=f"distance {baseline.update(rate)['distance']:.2f} steps")
            learner.discriminator.net = baseline.net  # what is measured as the reward
            own += measure(config, learner, layouts_of(config.grid), learner.pairs)
            others += measure(config, learner, unseen, learner.pairs)
    names = ("reoptimised", "spearman", "epic", "avoid_rank", "matched_avoid_rank", "sensitivity")
    return {
        "trained_layouts": {name: means(own)[name] for name in names},
        "unseen_layouts": {**{name: means(others)[name] for name in names}, "avoid": summary(others)["avoid"]},
        "updates": UPDATES,
        "env_steps": 0,
        "cpu_seconds": round(float(np.mean((time.process_time() - began_s) / seeds)), 2),
        "seeds": seeds,
    }
