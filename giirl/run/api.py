"""Train, evaluate and load runs from Python: what `giirl train` and `giirl evaluate` do, as functions.

config = load_config(Path("experiments/miniwob_four.toml"), ["runtime=serial"])
folder = RunFolder.create(config, "mine")
result = train(config, folder)
reward, policy = load_reward(folder.path), load_policy(folder.path)
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from giirl.run.folder import RunFolder
from giirl.run.worlds import open_web_run, world_of
from giirl_core.config import Config
from giirl_core.config_file import load_config
from giirl_core.files import explain, write_json
from giirl_core.progress import Display

if TYPE_CHECKING:
    from actors.agents import PolicyAgent
    from giirl_core.nets.reward import RewardModel


def train(
    config: Config, folder: RunFolder, checkpoint: Path | None = None, display: Display | None = None
) -> dict[str, Any]:
    """Train in `folder`, evaluate, write result.json and return what is in it.

    `checkpoint` is one of the folder's checkpoints and resumes from there. A new run that fails before its first
    checkpoint removes what it wrote. SIGINT, SIGTERM and SIGHUP save a checkpoint and raise `giirl.signals.Stopped`.
    From the first checkpoint on, a full disk or another error of the operating system is a RuntimeError that says how
    to go on.
    """
    with folder.held():
        try:
            if checkpoint is None:
                folder.clear()
            result = world_of(config).train(config, folder, checkpoint, display or Display())
            write_json(folder.result, result)
        except OSError as error:
            if not folder.saved:
                raise
            raise RuntimeError(f"{explain(error)}{folder.way_on}") from error
        finally:
            folder.discard_unless_saved()
    return result


def evaluate(run: Path, overrides: Sequence[str] = (), display: Display | None = None) -> dict[str, Any]:
    """Success of a run's greedy policy on fresh pages with the random baseline; or its return in LanguageGridCraft.

    `overrides` are settings as `key=value`, such as "evaluate.episodes=500". The result has the form of result.json.
    """
    folder, _ = RunFolder.open(run)
    config = load_config(folder.config_file, overrides)
    checkpoint, world = folder.latest_checkpoint(), world_of(config)
    world.check(config)
    start_s = time.monotonic()
    result = world.evaluate(config, folder, checkpoint, display or Display())
    result["seconds"] = round(time.monotonic() - start_s, 1)
    return result


def load_reward(run: Path) -> RewardModel:
    """The learned reward r(s, a | g) of a run on web pages, from its last checkpoint; ValueError if it has none."""
    from giirl.run.train import reward_of_run
    from giirl_core.nets.reward import build_reward

    _, config = open_web_run(run)
    return build_reward(config, reward_of_run(run))


def load_policy(run: Path, *, greedy: bool = True) -> PolicyAgent:
    """The policy of a run on web pages, from its last checkpoint: greedy, or sampling its actions."""
    from actors.agents import PolicyAgent
    from giirl_core.nets.language import load_vectors
    from giirl_core.nets.reward import build_policy

    folder, config = open_web_run(run)
    agent = PolicyAgent(build_policy(config), load_vectors(config.net.vectors), greedy=greedy)
    agent.load(folder.weights(folder.latest_checkpoint(), "policy"))
    return agent
