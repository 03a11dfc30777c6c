"""The learner: Algorithm 1 of Luo (2019), the baselines, their losses and networks, and checkpoints."""

from typing import TYPE_CHECKING

from giirl_core import lazy_exports

__all__ = [
    "Learner",
    "latest_checkpoint",
    "save_checkpoint",
]

# Where each public name is defined
_MODULES = {
    "Learner": "learner.learner",
    "latest_checkpoint": "learner.checkpoint",
    "save_checkpoint": "learner.checkpoint",
}

if TYPE_CHECKING:
    from learner.checkpoint import latest_checkpoint, save_checkpoint
    from learner.learner import Learner
else:
    __getattr__, __dir__ = lazy_exports(__name__, _MODULES)
