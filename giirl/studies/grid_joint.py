"""The study of many layouts and goals at once, and of transfer to unseen layouts and sentences."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from giirl.run.grid import GridRun, draw_rewards, layouts_of, read_pair, summary
from giirl.run.grid_metrics import Measures, means, measure
from giirl.studies.grid_ablations import shaped_against_sparse
from giirl.studies.grid_figures import SENTENCES, learn_all
from giirl.studies.grid_settings import UNSEEN_LAYOUT_SEED, few, held_out_of_three, held_out_pairs, joint
from giirl_core.config import Config
from giirl_core.progress import Display
from gridcraft.layouts import Layout, random_layout

CLONING_UPDATES = 1000
FEW = (1, 3)  # demonstrations per layout and goal, in addition to the joint setting
RENAME_PROB = 0.5  # of a sample of the discriminator, where colours are renamed

Trained = Sequence[tuple[Config, GridRun]]


def gridcraft_joint(seeds: int, out: Path, display: Display) -> dict[str, Any]:
    """The whole study: trained and unseen layouts, unseen pairs, few demonstrations, shaped and sparse rewards."""
    size = joint().grid.random_layouts
    unseen = [random_layout(UNSEEN_LAYOUT_SEED + number) for number in range(size)]
    trained = _train("joint", [joint(seed) for seed in range(seeds)], display)
    drawn = out / "gridcraft-joint.png"
    config, run = trained[0]
    draw_rewards(drawn, config, run.learner, unseen[0], SENTENCES)
    found = _measured(trained, unseen)
    demonstrations = {str(count): _few(seeds, count, unseen, display) for count in FEW}
    demonstrations[str(joint().grid.demonstrations)] = _compared(found)
    return {
        **summary(_measured(trained)),
        "unseen_layouts": {**_transfer(found), "avoid": summary(found)["avoid"]},
        "unseen_pairs": _unseen_pairs("4 of 12 pairs unseen", [held_out_pairs(s) for s in range(seeds)], display),
        "unseen_pairs_of_three": {
            name: _unseen_pairs(
                f"2 of 6 pairs unseen, {name}", [held_out_of_three(s, r) for s in range(seeds)], display
            )
            for name, r in (("plain", 0.0), ("colours_renamed", RENAME_PROB))
        },
        "demonstrations": demonstrations,
        "steps_to_optimal": shaped_against_sparse(seeds, display),
        "env_steps": max(run.env_steps for _, run in trained),
        "cpu_seconds": round(float(np.mean([run.cpu_s for _, run in trained])), 2),
        "figure": str(drawn),
        "seeds": seeds,
    }


def _train(what: str, configs: Sequence[Config], display: Display) -> Trained:
    """Train GIIRL, and clone from the same demonstrations with a net of the same shape."""
    runs = learn_all(what, configs, display)
    for config, run in zip(configs, runs, strict=True):
        for _ in range(CLONING_UPDATES):
            run.learner.cloner.update(run.learner.demos.sample(config.cloning.batch))
    return list(zip(configs, runs, strict=True))


def _measured(trained: Trained, layouts: Sequence[Layout] = ()) -> list[Measures]:
    """Measure every run in these layouts, by default its own, under the pairs that it trained on."""
    return [
        one
        for config, run in trained
        for one in measure(config, run.learner, layouts or layouts_of(config.grid), run.learner.pairs)
    ]


def _unseen_pairs(what: str, configs: Sequence[Config], display: Display) -> dict[str, float]:
    """Train without the held-out pairs, and measure on them."""
    pairs = [read_pair(text) for text in configs[0].grid.held_out]
    trained = _train(what, configs, display)
    return _transfer([one for c, run in trained for one in measure(c, run.learner, layouts_of(c.grid), pairs)])


def _few(seeds: int, count: int, unseen: Sequence[Layout], display: Display) -> dict[str, float]:
    trained = _train(f"{count} demonstrations a goal", [few(seed, count) for seed in range(seeds)], display)
    return _compared(_measured(trained, unseen))


def _compared(found: Sequence[Measures]) -> dict[str, float]:
    """Normalised returns: re-optimised on the reward, learned policy, cloning."""
    mean = means(found)
    return {"giirl": mean["reoptimised"], "policy": mean["policy"], "cloning": mean["cloning"]}


def _transfer(found: Sequence[Measures]) -> dict[str, float]:
    mean = means(found)
    return {"reward_reoptimised": mean["reoptimised"], "policy": mean["policy"], "cloning": mean["cloning"]}
