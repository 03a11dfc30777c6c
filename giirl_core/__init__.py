"""The shared core: data types, configuration, metrics, message formats, networks and process supervision.

The package imports no other package of the project. `import giirl_core` loads none of its modules.
"""

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING

__all__ = [
    "Action",
    "Browser",
    "Command",
    "Config",
    "Episode",
    "EpisodeSpec",
    "Goal",
    "Observation",
    "Outcome",
    "Page",
    "RewardModel",
    "ScoreClient",
    "StepResult",
    "Trajectory",
    "Verb",
    "Weights",
    "load_config",
    "read_episodes",
    "write_episodes",
]


def lazy_exports(package: str, modules: Mapping[str, str]) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package that imports a module when one of its public names is used (PEP 562).

    `modules` gives the module that defines each name. Other names are an AttributeError.
    """

    def find(name: str) -> object:
        if name in modules:
            return getattr(import_module(modules[name]), name)
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    def names() -> list[str]:
        return sorted({*vars(sys.modules[package]), *modules})

    return find, names


# Where each public name is defined
_MODULES = {
    "Action": "giirl_core.types",
    "Browser": "giirl_core.types",
    "Command": "giirl_core.types",
    "Config": "giirl_core.config",
    "Episode": "giirl_core.types",
    "EpisodeSpec": "giirl_core.types",
    "Goal": "giirl_core.types",
    "Observation": "giirl_core.types",
    "Outcome": "giirl_core.types",
    "Page": "giirl_core.types",
    "RewardModel": "giirl_core.nets.reward",
    "ScoreClient": "giirl_core.wire.score_client",
    "StepResult": "giirl_core.types",
    "Trajectory": "giirl_core.types",
    "Verb": "giirl_core.types",
    "Weights": "giirl_core.weights",
    "load_config": "giirl_core.config_file",
    "read_episodes": "giirl_core.wire.messages",
    "write_episodes": "giirl_core.wire.messages",
}

if TYPE_CHECKING:
    from giirl_core.config import Config
    from giirl_core.config_file import load_config
    from giirl_core.nets.reward import RewardModel
    from giirl_core.types import (
        Action,
        Browser,
        Command,
        Episode,
        EpisodeSpec,
        Goal,
        Observation,
        Outcome,
        Page,
        StepResult,
        Trajectory,
        Verb,
    )
    from giirl_core.weights import Weights
    from giirl_core.wire.messages import read_episodes, write_episodes
    from giirl_core.wire.score_client import ScoreClient
else:
    __getattr__, __dir__ = lazy_exports(__name__, _MODULES)
