"""One environment's tab in a farm: the episode in progress there, in the miniwob package's format."""

from __future__ import annotations

import operator
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from browser_farm.gym.adapter import ActionDict, Fields, MiniWoBAdapter, ObservationDict, root_dom
from browser_farm.gym.agent_action import agent_action
from browser_farm.gym.elements import Elements, elements_of
from browser_farm.gym.own_pages import is_rewarded
from giirl_core.types import Action, Command, EpisodeSpec, Goal, Observation, StepResult

MAX_SEED = 2**31  # exclusive, for page seeds that an environment samples
DATA_MODES = ("train", "test", "default")
RESET_RESULT = StepResult(raw_reward=0.0, done=False, observation=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResetOptions:
    """The options of `reset`, which stay in effect until another reset changes them."""

    data_mode: str = "train"
    record_screenshots: bool = False

    def __post_init__(self) -> None:
        if self.data_mode not in DATA_MODES:
            raise ValueError(f"data_mode is {self.data_mode!r}, wanted one of: {', '.join(DATA_MODES)}")

    def updated(self, options: Mapping[str, Any] | None) -> ResetOptions:
        """A copy with these options changed; ValueError for an unknown one."""
        unknown = set(options or ()) - {"data_mode", "record_screenshots"}
        if unknown:
            raise ValueError(f"reset got option {min(unknown)!r}, wanted 'data_mode' or 'record_screenshots'")
        return replace(self, **(options or {}))


class EnvSlot:
    """The state of one environment: its task, page seed and current page."""

    def __init__(self, adapter: MiniWoBAdapter, *, agent_page: bool = False) -> None:
        """`agent_page` adds to `info` what an agent of this project sees and does."""
        self.adapter, self.agent_page = adapter, agent_page
        self.seed = 0
        self.page: Elements | None = None  # None before the first episode and after the end of one
        self.fields: Fields = ()
        self.episodes = 0  # begun so far
        self.begun_s = 0.0  # time.monotonic() at the beginning of the episode
        self.goal = Goal("-")  # of the episode
        self._actions: list[Action | None] = []  # the action since the last `info`, as an agent's; None for others

    def sample_episode(self, rng: np.random.Generator, options: ResetOptions, seed: int | None = None) -> EpisodeSpec:
        """The episode with this page seed, or with one that `rng` samples."""
        page_seed = int(rng.integers(MAX_SEED)) if seed is None else seed
        return EpisodeSpec(task=self.adapter.task, seed=page_seed, mode=options.data_mode)

    def begin(self, observation: Observation) -> None:
        self.episodes, self.begun_s = self.episodes + 1, time.monotonic()
        self.seed, self.page = observation.episode.seed, elements_of(observation)
        self.fields, self.goal = self.adapter.fields(self.page), observation.goal

    def command(self, action: ActionDict | None, following: EpisodeSpec | None = None) -> Command:
        assert self.page is not None, "begin() comes first"
        command = self.adapter.command(action, self.page, self.fields)
        if self.agent_page and self.page.agent_page is not None:
            self._actions = [agent_action(command, self.page.agent_page, self.goal)]
        return replace(command, following=following)

    def advance(self, result: StepResult) -> None:
        """Take over the page after an action; None if the episode is over."""
        continues = result.observation is not None and not result.done and not result.lost
        self.page = elements_of(result.observation) if continues and result.observation else None

    def observation(self, screenshot: NDArray[np.uint8] | None) -> ObservationDict:
        if self.page is None:
            return self.adapter.empty_observation()
        return self.adapter.observe(self.page, self.fields, screenshot)

    def info(self, result: StepResult = RESET_RESULT, *, with_dom: bool, elapsed: bool = False) -> dict[str, Any]:
        """The package's `info`. `with_dom` adds the page as a tree of DOMElement, `elapsed` the episode's duration.

        That of a task file has "measured": whether its rewards say anything. With `agent_page` there are "page" and
        "goal" while an episode goes on, and "action" after a step: None for one that agents do not know.
        """
        info: dict[str, Any] = {
            "done": result.done,
            "env_reward": result.raw_reward if result.scaled_reward is None else result.scaled_reward,
            "raw_reward": result.raw_reward,
            "reason": result.reason or None,
            "seed": self.seed,
        }
        if self.adapter.site is not None:
            info["measured"] = is_rewarded(self.adapter.site)
        if elapsed:
            info["elapsed"] = time.monotonic() - self.begun_s
        if result.lost:
            info["lost"] = result.lost
        if self._actions:
            info["action"] = self._actions.pop()
        if self.agent_page and self.page is not None:
            info["page"], info["goal"] = self.page.agent_page, self.goal
        if with_dom and self.page is not None:
            info["root_dom"] = root_dom(self.page)
        return info

    def reward(self, info: Mapping[str, Any]) -> float:
        """The processed reward of a step. An episode that is lost is void: it has none."""
        return 0.0 if "lost" in info else float(self.adapter.reward_processor(info))


def checked_seed(seed: Any) -> int:
    """An integer of any kind as int; TypeError for anything else."""
    try:
        return operator.index(seed)
    except TypeError:
        raise TypeError(f"the seed is {seed!r}: wanted an integer") from None
