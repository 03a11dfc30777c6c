"""One environment's tab in a farm: the episode in progress there, in the miniwob package's format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from browser_farm.gym.adapter import ActionDict, Fields, MiniWoBAdapter, ObservationDict, root_dom
from browser_farm.gym.elements import Elements, elements_of
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult

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

    def __init__(self, adapter: MiniWoBAdapter) -> None:
        self.adapter = adapter
        self.seed = 0
        self.page: Elements | None = None  # None before the first episode and after the end of one
        self.fields: Fields = ()

    def sample_episode(self, rng: np.random.Generator, options: ResetOptions, seed: int | None = None) -> EpisodeSpec:
        """The episode with this page seed, or with one that `rng` samples."""
        page_seed = int(rng.integers(MAX_SEED)) if seed is None else seed
        return EpisodeSpec(task=self.adapter.task, seed=page_seed, mode=options.data_mode)

    def begin(self, observation: Observation) -> None:
        self.seed, self.page = observation.episode.seed, elements_of(observation)
        self.fields = self.adapter.fields(self.page)

    def command(self, action: ActionDict | None, following: EpisodeSpec | None = None) -> Command:
        assert self.page is not None, "begin() comes first"
        return replace(self.adapter.command(action, self.page, self.fields), following=following)

    def advance(self, result: StepResult) -> None:
        """Take over the page after an action; None if the episode is over."""
        continues = result.observation is not None and not result.done and not result.lost
        self.page = elements_of(result.observation) if continues and result.observation else None

    def observation(self, screenshot: NDArray[np.uint8] | None) -> ObservationDict:
        if self.page is None:
            return self.adapter.empty_observation()
        return self.adapter.observe(self.page, self.fields, screenshot)

    def info(self, result: StepResult = RESET_RESULT, *, with_dom: bool) -> dict[str, Any]:
        """The package's `info`, without "elapsed". `with_dom` adds the page as a tree of DOMElement."""
        info = {
            "done": result.done,
            "env_reward": result.raw_reward,  # equal, since our rewards do not shrink with time
            "raw_reward": result.raw_reward,
            "reason": result.reason or None,
            "seed": self.seed,
        }
        if result.lost:
            info["lost"] = result.lost
        if with_dom and self.page is not None:
            info["root_dom"] = root_dom(self.page)
        return info


def checked_render_mode(render_mode: str | None, modes: list[str]) -> str | None:
    """The render mode itself; ValueError when it is not one of `modes`."""
    if render_mode not in (None, *modes):
        raise ValueError(f"render_mode is {render_mode!r}, wanted {' or '.join(modes)}, or None")
    return render_mode
