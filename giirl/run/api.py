"""Train, evaluate and load runs from Python: what `giirl train` and `giirl evaluate` do, as functions.

config = load_config(Path("experiments/miniwob_four.toml"), ["runtime=serial"])
folder = RunFolder.create(config, "mine")
result = train(config, folder)
reward, policy = LearnedReward(folder.path), load_policy(folder.path)
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
from giirl_core.telemetry.version import commit
from giirl_core.types import Action, Goal, Observation, Page

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from actors.agents import PolicyAgent
    from giirl_core.nets.reward import RewardModel

BATCH = 64  # pages that a net reads at a time


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
            made_by = commit()  # before the files change
            result = world_of(config).train(config, folder, checkpoint, display or Display()) | {"commit": made_by}
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


class LearnedReward:
    """The learned reward r(s, a | g) of a run on web pages, or of a file that `giirl reward export` wrote.

    A file needs neither its run nor Chrome nor Ray. `version` is the learner step of the reward, `form` how its logit
    became a reward. ValueError, one line, for a run without a learned reward and for a damaged or foreign file.

    An observation is a page, or an `Observation`; goals are `Goal` or text. `gestures` are the actions that the net
    knows, without their elements: to click, to type words of the goal, and what the demonstrations showed. Any other
    action is a ValueError that says which.
    """

    def __init__(self, run_or_file: str | Path) -> None:
        from giirl_core.nets.reward import import_reward

        path = Path(run_or_file)
        self.model = load_reward(path) if path.is_dir() else import_reward(path)
        self.version, self.form = self.model.version, self.model.form
        self.gestures = tuple(map(str, self.model.net.gestures))

    def score(self, observation: Observation | Page, action: Action, goal: Goal | str) -> float:
        """The reward of one action on one page under a goal."""
        return float(self.score_actions(observation, [action], goal)[0])

    def score_actions(
        self, observation: Observation | Page, actions: Sequence[Action], goal: Goal | str
    ) -> NDArray[np.float32]:
        """[M] rewards of M actions on one page, which is read only once."""
        page, goal = _page_of(observation), _goal_of(goal)
        for action in actions:
            _check_action(action, page, goal)
        return self.model.score_actions(page, goal, actions)

    def score_batch(
        self, observations: Sequence[Observation | Page], actions: Sequence[Action], goals: Sequence[Goal | str]
    ) -> NDArray[np.float32]:
        """[B] rewards of B triples of an observation, an action and a goal; ValueError for different lengths."""
        import numpy as np

        counts = len(observations), len(actions), len(goals)
        if len(set(counts)) > 1:
            raise ValueError("got {} observations, {} actions and {} goals: wanted as many of each".format(*counts))
        triples = list(zip(actions, map(_page_of, observations), map(_goal_of, goals), strict=True))
        for triple in triples:
            _check_action(*triple)
        rewards = [np.zeros(0, np.float32)]
        for first in range(0, len(triples), BATCH):
            acts, pages, instructions = zip(*triples[first : first + BATCH], strict=True)
            rewards.append(self.model.score_pairs(pages, acts, instructions).numpy())
        return np.concatenate(rewards)


def _page_of(observation: Observation | Page) -> Page:
    return observation.page if isinstance(observation, Observation) else observation


def _goal_of(goal: Goal | str) -> Goal:
    return Goal(goal) if isinstance(goal, str) else goal


def _check_action(action: Action, page: Page, goal: Goal) -> None:
    """ValueError for an action that is on no element or no word that exists."""
    if max(action.element, action.to) >= len(page):
        row = max(action.element, action.to)
        raise ValueError(f"the action is on element {row}: wanted one of the {len(page)} of the page")
    if action.end >= len(goal.tokens):
        raise ValueError(f"the action types tokens {action.start}..{action.end}: the goal has {len(goal.tokens)}")
