"""LanguageGridCraft, the tabular world of Luo (2019), with an exact planner and metrics for learned rewards.

Importing the package registers `giirl/LanguageGridCraft-v0` with Gymnasium.
"""

from gymnasium import register

from gridcraft.env import LanguageGridCraft
from gridcraft.instructions import ColourPair
from gridcraft.layouts import Layout, named_layout, random_layout
from gridcraft.planning import solve
from gridcraft.world import World, build_world, true_reward

__all__ = [
    "ColourPair",
    "LanguageGridCraft",
    "Layout",
    "World",
    "build_world",
    "named_layout",
    "random_layout",
    "solve",
    "true_reward",
]


register(id="giirl/LanguageGridCraft-v0", entry_point="gridcraft.env:LanguageGridCraft")
