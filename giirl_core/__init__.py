"""The shared core: data types, configuration, metrics, message formats, networks and process supervision.

The package imports no other package of the project. `import giirl_core` loads none of its modules.
"""

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

# Where each public name is defined; its module is imported when the name is first used (PEP 562).
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

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return getattr(import_module(_MODULES[name]), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
