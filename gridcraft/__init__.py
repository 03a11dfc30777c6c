"""LanguageGridCraft, the tabular world of Luo (2019), with an exact planner and metrics for learned rewards.

Importing the package registers `giirl/LanguageGridCraft-v0` with Gymnasium and loads none of its modules.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from gymnasium import register

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

# Where each public name is defined; its module is imported when the name is first used (PEP 562).
_MODULES = {
    "LanguageGridCraft": "gridcraft.env",
    "Layout": "gridcraft.layouts",
    "ColourPair": "gridcraft.instructions",
    "World": "gridcraft.world",
    "build_world": "gridcraft.world",
    "named_layout": "gridcraft.layouts",
    "random_layout": "gridcraft.layouts",
    "solve": "gridcraft.planning",
    "true_reward": "gridcraft.world",
}

if TYPE_CHECKING:
    from gridcraft.env import LanguageGridCraft
    from gridcraft.instructions import ColourPair
    from gridcraft.layouts import Layout, named_layout, random_layout
    from gridcraft.planning import solve
    from gridcraft.world import World, build_world, true_reward
else:

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return getattr(import_module(_MODULES[name]), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


register(id="giirl/LanguageGridCraft-v0", entry_point="gridcraft.env:LanguageGridCraft")
