"""Actors: they run the policy in many browser tabs at once and stream the episodes to the learner."""

from importlib import import_module
from typing import TYPE_CHECKING

__all__ = [
    "Agent",
    "Decision",
    "ExpertAgent",
    "PolicyAgent",
    "RandomAgent",
    "Schedule",
    "play",
]

# Where each public name is defined; its module is imported when the name is first used (PEP 562).
_MODULES = {
    "Agent": "actors.agents",
    "Decision": "actors.agents",
    "ExpertAgent": "actors.agents",
    "PolicyAgent": "actors.agents",
    "RandomAgent": "actors.agents",
    "Schedule": "actors.schedule",
    "play": "actors.rollouts",
}

if TYPE_CHECKING:
    from actors.agents import Agent, Decision, ExpertAgent, PolicyAgent, RandomAgent
    from actors.rollouts import play
    from actors.schedule import Schedule
else:

    def __getattr__(name: str) -> object:
        if name in _MODULES:
            return getattr(import_module(_MODULES[name]), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})
