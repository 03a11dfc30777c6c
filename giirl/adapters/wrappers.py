"""Gymnasium wrappers that put the learned reward in the place of the page's: one environment, and a vector of them.

env = gymnasium.make("giirl/MiniWoB-v0", task="click-button", agent_page=True)
env = LearnedRewardWrapper(env, "runs/mine")
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray

from giirl.run.api import LearnedReward
from giirl_core.nets.reward import reward_of
from giirl_core.types import Action, Goal, Page

Flags = NDArray[np.bool_]
Step = tuple[Page, Goal, Action | None]  # what was seen, and what was done


class LearnedRewardWrapper(gymnasium.Wrapper[Any, Any, Any, Any]):
    """One environment with the learned reward r(s, a | g) of a run or of an exported file.

    The environment's own reward is in `info["true_reward"]`. An action that the nets do not know, such as a key or the
    mouse wheel, has the reward `unknown`; by default the least that the learned reward can be, as an expert never does
    it. A lost episode has none: 0, `truncated` and `info["lost"]`, as before. The form `goal` rewards only the last
    step.

    ValueError for an environment without `agent_page=True`, whose `info` does not have what the reward reads.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], reward: LearnedReward | str | Path, *, unknown: float | None = None
    ) -> None:
        super().__init__(env)
        self._reward = _Rewards(reward, unknown)
        self._seen: tuple[Page, Goal] | None = None  # None before the first episode and after the end of one

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        _check(info)
        self._seen = info["page"], info["goal"]
        return observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Act, and reward the action on the page that was seen before it."""
        observation, true_reward, terminated, truncated, info = self.env.step(action)
        info["true_reward"] = true_reward
        steps = {} if self._seen is None or "lost" in info else {0: (*self._seen, info.get("action"))}
        reward = self._reward.of(steps, np.array([terminated or truncated]))[0]
        self._seen = (info["page"], info["goal"]) if "page" in info else None
        return observation, float(reward), terminated, truncated, info


class LearnedRewardVectorWrapper(VectorWrapper[Any, Any, Any]):
    """A vector of environments with the learned reward, see `LearnedRewardWrapper`. A step scores all in one batch.

    The step that only begins another episode has the reward 0, as in the environment.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], reward: LearnedReward | str | Path, *, unknown: float | None = None
    ) -> None:
        super().__init__(env)
        self._reward = _Rewards(reward, unknown)
        self._seen: dict[int, tuple[Page, Goal]] = {}  # by environment, while its episode goes on

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in each environment."""
        observations, infos = self.env.reset(seed=seed, options=options)
        _check(infos)
        self._seen = self._pages(infos)
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Act in each environment, and reward each action on the page that was seen before it."""
        observations, true_rewards, terminated, truncated, infos = self.env.step(actions)
        infos["true_reward"] = true_rewards.copy()
        infos["_true_reward"] = np.ones(self.num_envs, dtype=np.bool_)
        lost = infos.get("_lost", np.zeros(self.num_envs, dtype=np.bool_))
        acted = infos.get("_action", np.zeros(self.num_envs, dtype=np.bool_)) & ~lost
        steps = {i: (*self._seen[i], infos["action"][i]) for i in np.flatnonzero(acted).tolist() if i in self._seen}
        rewards = self._reward.of(steps, terminated | truncated)
        self._seen = self._pages(infos)
        return observations, rewards, terminated, truncated, infos

    def _pages(self, infos: Mapping[str, Any]) -> dict[int, tuple[Page, Goal]]:
        shown = np.flatnonzero(infos.get("_page", np.zeros(self.num_envs, dtype=np.bool_)))
        return {index: (infos["page"][index], infos["goal"][index]) for index in shown.tolist()}


class _Rewards:
    """The rewards of steps."""

    def __init__(self, reward: LearnedReward | str | Path, unknown: float | None) -> None:
        self._learned = reward if isinstance(reward, LearnedReward) else LearnedReward(reward)
        clip = self._learned.model.clip
        least = reward_of(torch.tensor(-clip), self._learned.form, clip)
        self._unknown = float(least) if unknown is None else unknown

    def of(self, steps: Mapping[int, Step], ended: Flags) -> NDArray[np.float64]:
        """[N] rewards of the steps of N environments, 0 without a step; `ended` says whose episode is over."""
        rewards = np.zeros(len(ended))
        if self._learned.form == "goal":
            steps = {index: step for index, step in steps.items() if ended[index]}
        known = {index: (page, action, goal) for index, (page, goal, action) in steps.items() if action is not None}
        rewards[[index for index in steps if index not in known]] = self._unknown
        if known:
            rewards[list(known)] = self._learned.score_batch(*zip(*known.values(), strict=True))
        return rewards


def _check(info: Mapping[str, Any]) -> None:
    if "page" not in info or "goal" not in info:
        raise ValueError(
            "the environment does not say what the learned reward reads: "
            'wanted gymnasium.make("giirl/MiniWoB-v0", ..., agent_page=True), or make_vec'
        )
