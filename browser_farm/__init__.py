"""Browsers for agents: MiniWoB++ tasks in headless Chrome, their Gymnasium environments, experts and recordings.

Importing the package registers `giirl/MiniWoB-v0` with Gymnasium. Chrome and its libraries are loaded when a name that
needs them is first used. `FakeFarm` is a simulated browser for tests.
"""

from typing import TYPE_CHECKING

from gymnasium import register

from giirl_core import lazy_exports

__all__ = [
    "Action",
    "Browser",
    "ChromeFarm",
    "Command",
    "EpisodeSpec",
    "FakeFarm",
    "Goal",
    "MiniWoB",
    "MiniWoBVector",
    "Observation",
    "Page",
    "StepResult",
    "Verb",
]

# Where each public name is defined
_MODULES = {
    "Action": "giirl_core.types",
    "Browser": "giirl_core.types",
    "ChromeFarm": "browser_farm.farm",
    "Command": "giirl_core.types",
    "EpisodeSpec": "giirl_core.types",
    "FakeFarm": "browser_farm.fake",
    "Goal": "giirl_core.types",
    "MiniWoB": "browser_farm.gym.env",
    "MiniWoBVector": "browser_farm.gym.vector_env",
    "Observation": "giirl_core.types",
    "Page": "giirl_core.types",
    "StepResult": "giirl_core.types",
    "Verb": "giirl_core.types",
}

if TYPE_CHECKING:
    from browser_farm.fake import FakeFarm
    from browser_farm.farm import ChromeFarm
    from browser_farm.gym.env import MiniWoB
    from browser_farm.gym.vector_env import MiniWoBVector
    from giirl_core.types import Action, Browser, Command, EpisodeSpec, Goal, Observation, Page, StepResult, Verb
else:
    __getattr__, __dir__ = lazy_exports(__name__, _MODULES)


register(
    id="giirl/MiniWoB-v0",
    entry_point="browser_farm.gym.env:MiniWoB",
    vector_entry_point="browser_farm.gym.vector_env:MiniWoBVector",
)
