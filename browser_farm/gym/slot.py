"""One environment's place in a farm: the episode that is under way there, in the miniwob package's words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from browser_farm.gym.adapter import Fields, MiniWoBAdapter, Observed, Wanted, root_dom
from browser_farm.gym.elements import Elements, elements_of
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult

SEEDS = 2**31  # pages that an environment draws from when it is not told which
MODES = ("train", "test", "default")
OPENING = StepResult(raw_reward=0.0, done=False, observation=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResetOptions:
    """What may change from one reset to the next."""

    data_mode: str = "train"
    record_screenshots: bool = False

    def __post_init__(self) -> None:
        if self.data_mode not in MODES:
            raise ValueError(f"data_mode is {self.data_mode!r}, wanted one of: {', '.join(MODES)}")

    def updated(self, options: Mapping[str, Any] | None) -> ResetOptions:
        """As the options of a reset say; ValueError for one that is unknown."""
        unknown = set(options or ()) - {"data_mode", "record_screenshots"}
        if unknown:
            raise ValueError(f"reset got option {min(unknown)!r}, wanted 'data_mode' or 'record_screenshots'")
        return replace(self, **(options or {}))


class EnvSlot:
    """What one environment shows."""

    def __init__(self, package: MiniWoBAdapter) -> None:
        self.package = package
        self.seed = 0
        self.page: Elements | None = None  # None before the first episode and when one is over
        self.fields: Fields = ()

    def draw(self, generator: np.random.Generator, conduct: ResetOptions, seed: int | None = None) -> EpisodeSpec:
        """The page of this seed, or one that the generator draws."""
        drawn = int(generator.integers(SEEDS)) if seed is None else seed
        return EpisodeSpec(task=self.package.task, seed=drawn, mode=conduct.data_mode)

    def begin(self, observation: Observation) -> None:
        self.seed, self.page = observation.episode.seed, elements_of(observation)
        self.fields = self.package.fields(self.page)

    def command(self, action: Wanted | None, following: EpisodeSpec | None = None) -> Command:
        assert self.page is not None, "begin() comes first"
        return replace(self.package.command(action, self.page, self.fields), following=following)

    def advance(self, result: StepResult) -> None:
        """Show what an action led to."""
        goes_on = result.observation is not None and not result.done and not result.lost
        self.page = elements_of(result.observation) if goes_on and result.observation else None

    def observed(self, picture: NDArray[np.uint8] | None) -> Observed:
        if self.page is None:
            return self.package.blank()
        return self.package.observe(self.page, self.fields, picture)

    def info(self, result: StepResult = OPENING, *, tree: bool) -> dict[str, Any]:
        """What the package tells beside the observation. Time takes no part in our rewards."""
        info = {
            "done": result.done,
            "env_reward": result.raw_reward,
            "raw_reward": result.raw_reward,
            "reason": result.reason or None,
            "seed": self.seed,
        }
        if result.lost:
            info["lost"] = result.lost
        if tree and self.page is not None:
            info["root_dom"] = root_dom(self.page)
        return info


def checked_render_mode(render_mode: str | None, modes: list[str]) -> str | None:
    if render_mode not in (None, *modes):
        raise ValueError(f"the browser cannot render as {render_mode!r}, wanted {' or '.join(modes)}, or nothing")
    return render_mode
