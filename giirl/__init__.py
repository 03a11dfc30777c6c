"""GIIRL from Python and from the command line: train, evaluate, report and reproduce.

`import giirl` loads none of its modules; torch and Ray are loaded when a name that needs them is first used.
"""

from typing import TYPE_CHECKING

from giirl_core import lazy_exports

__all__ = [
    "Config",
    "LearnedReward",
    "LearnedRewardVectorWrapper",
    "LearnedRewardWrapper",
    "RunFolder",
    "evaluate",
    "load_config",
    "load_policy",
    "load_reward",
    "read_episodes",
    "train",
    "write_episodes",
]

# Where each public name is defined
_MODULES = {
    "Config": "giirl_core.config",
    "LearnedReward": "giirl.run.api",
    "LearnedRewardVectorWrapper": "giirl.adapters.wrappers",
    "LearnedRewardWrapper": "giirl.adapters.wrappers",
    "RunFolder": "giirl.run.folder",
    "evaluate": "giirl.run.api",
    "load_config": "giirl_core.config_file",
    "load_policy": "giirl.run.api",
    "load_reward": "giirl.run.api",
    "read_episodes": "giirl_core.wire.messages",
    "train": "giirl.run.api",
    "write_episodes": "giirl_core.wire.messages",
}

if TYPE_CHECKING:
    from giirl.adapters.wrappers import LearnedRewardVectorWrapper, LearnedRewardWrapper
    from giirl.run.api import LearnedReward, evaluate, load_policy, load_reward, train
    from giirl.run.folder import RunFolder
    from giirl_core.config import Config
    from giirl_core.config_file import load_config
    from giirl_core.wire.messages import read_episodes, write_episodes
else:
    __getattr__, __dir__ = lazy_exports(__name__, _MODULES)
