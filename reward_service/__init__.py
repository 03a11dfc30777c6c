"""The reward service: it scores trajectories with the learned reward and reports the reward's version."""

from importlib import import_module
from typing import TYPE_CHECKING

__all__ = [
    "RewardService",
    "ServiceLimits",
]

# Where each public name is defined; its module is imported when the name is first used (PEP 562).
_MODULES = {
    "RewardService": "reward_service.service",
    "ServiceLimits": "reward_service.service",
}

if TYPE_CHECKING:
    from reward_service.service import RewardService, ServiceLimits
else:

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return getattr(import_module(_MODULES[name]), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
