"""The reward service: it scores trajectories with the learned reward and reports the reward's version."""

from typing import TYPE_CHECKING

from giirl_core import lazy_exports

__all__ = [
    "RewardService",
    "ServiceLimits",
]

# Where each public name is defined
_MODULES = {
    "RewardService": "reward_service.service",
    "ServiceLimits": "reward_service.service",
}

if TYPE_CHECKING:
    from reward_service.service import RewardService, ServiceLimits
else:
    __getattr__, __dir__ = lazy_exports(__name__, _MODULES)
