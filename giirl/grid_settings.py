"""The settings of the tabular chapter's studies, found with other seeds and layouts than those they are reported on."""

from __future__ import annotations

import dataclasses

from giirl.config import CloningConfig, Config, DiscriminatorConfig, GridConfig, PolicyConfig
from giirl.gridcraft_layouts import COLOURS

REPORT_SEEDS = 10  # seeds 0 to 9; those from 100 on were used to tune
JOINT_SEEDS = 5
UNSEEN_LAYOUT_SEED = 2000  # layouts never trained on; those from 5000 on were used to tune
UNSEEN_PAIRS = ("red-green", "green-blue", "blue-yellow", "yellow-red")  # every colour once as each


def thesis(seed: int = 0) -> Config:
    """One layout with three regions and all the goals it has: figures 4.3 and 4.4."""
    return Config(
        world="gridcraft",
        seed=seed,
        iterations=66,
        rollout_batch=8,
        discriminator=DiscriminatorConfig(
            learning_rate=3e-3,
            updates=8,
            batch=64,
            clip=8.0,
            gradient_penalty=0.05,
            rollouts=0.25,
            replay=0.25,
            demo_states=0.0,
            chance=1.0,
            wrong_goal=2.0,
            rename=0.0,
        ),
        policy=PolicyConfig(updates=12, gamma=0.95, entropy=0.05, learning_rate=3e-3),
        cloning=CloningConfig(batch=8),
        grid=GridConfig(neighbours=True, demonstrations=20),
    )


def joint(seed: int = 0, layout_seed: int = 1000) -> Config:
    """Eight random layouts and all ordered pairs of three colours at once, told apart by what is around."""
    return Config(
        world="gridcraft",
        seed=seed,
        iterations=250,
        rollout_batch=16,
        discriminator=dataclasses.replace(thesis().discriminator, learning_rate=1e-3, updates=10),
        policy=PolicyConfig(updates=40, gamma=0.95, entropy=0.05, learning_rate=3e-3),
        cloning=CloningConfig(batch=8),
        grid=GridConfig(
            layouts=(), random_layouts=8, layout_seed=layout_seed, neighbours=True, whole_map=True, measure_every=50
        ),
    )


def _quick(whole: Config, grid: GridConfig) -> Config:
    """Enough for the reward, which is what is measured there; its policy stays behind."""
    policy = dataclasses.replace(whole.policy, updates=12)
    return dataclasses.replace(whole, grid=grid, policy=policy, iterations=100)


def few(seed: int, demonstrations: int) -> Config:
    """The joint setting from so many demonstrations per layout and goal."""
    whole = joint(seed)
    grid = dataclasses.replace(whole.grid, demonstrations=demonstrations)
    return _quick(whole, grid)


def held_out_pairs(seed: int) -> Config:
    """Four colours and 8 of their 12 ordered pairs: each colour is still a goal twice, and avoided twice."""
    whole = joint(seed)
    grid = dataclasses.replace(whole.grid, colours=COLOURS, held_out=UNSEEN_PAIRS)
    return _quick(whole, grid)
