"""Actors: they run the policy in many browser tabs at once and stream the episodes to the learner."""

from typing import TYPE_CHECKING

from giirl_core import lazy_exports

__all__ = [
    "Agent",
    "Decision",
    "ExpertAgent",
    "PolicyAgent",
    "RandomAgent",
    "Schedule",
    "play",
]

# Where each public name is defined
_MODULES = {
    "Agent": "actors.agents",
    "Decision": "actors.agents",
    "ExpertAgent": "actors.agents",
    "PolicyAgent": "actors.agents",
    "RandomAgent": "actors.agents",
    "Schedule": "actors.rollouts",
    "play": "actors.rollouts",
}

if TYPE_CHECKING:
    from actors.agents import Agent, Decision, ExpertAgent, PolicyAgent, RandomAgent
    from actors.rollouts import Schedule, play
else:
    __getattr__, __dir__ = lazy_exports(__name__, _MODULES)
