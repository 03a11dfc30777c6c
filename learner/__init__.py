"""The learner: Algorithm 1 of Luo (2019), the baselines, their losses and networks, and checkpoints."""

from importlib import import_module
from typing import TYPE_CHECKING

__all__ = [
    "Learner",
    "latest_checkpoint",
    "save_checkpoint",
]

# Where each public name is defined; its module is imported when the name is first used (PEP 562).
_MODULES = {
    "Learner": "learner.learner",
    "latest_checkpoint": "learner.checkpoint",
    "save_checkpoint": "learner.checkpoint",
}

if TYPE_CHECKING:
    from learner.checkpoint import latest_checkpoint, save_checkpoint
    from learner.learner import Learner
else:

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return getattr(import_module(_MODULES[name]), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
