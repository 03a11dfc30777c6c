"""MiniWoB++ as a Gymnasium environment with the miniwob package's own observations and actions.

`import browser_farm`, then `gymnasium.make("giirl/MiniWoB-v0", task="click-test")`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from browser_farm.elements import ELEMENTS, Elements
from browser_farm.farm import ChromeFarm
from browser_farm.package import Fields, Observed, Package, Wanted, root_dom
from giirl.spec import EpisodeSpec, Observation, StepResult

SEEDS = 2**31  # pages that an environment draws from when it is not told which
OPTIONS = ("data_mode", "record_screenshots")
MODES = ("train", "test", "default")


class MiniWoB(gymnasium.Env[Observed, Wanted]):
    """One task in one tab of a Chrome of its own.

    It differs from the package's environment in this: time takes no part (no reward shrinks and no episode ends by the
    clock, `info` has no "elapsed"); every page is as if newly loaded; screenshots are taken only when asked for; an
    episode that a broken browser cut off is `truncated`, with the cause in `info["lost"]`, and the next reset works.
    `info["seed"]` is the page's seed: `reset(seed=...)` shows exactly that page, `reset()` one that the environment's
    own generator draws.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 4}  # noqa: RUF012 (as declared)

    def __init__(
        self,
        task: str,
        *,
        render_mode: str | None = None,
        action_space_config: Any = "all_supported",  # a name, or an ActionSpaceConfig of the package
        field_extractor: Callable[[str], Fields] | None = None,
        reward_processor: Callable[[Mapping[str, Any]], float] | None = None,
        data_mode: str = "train",
        record_screenshots: bool = False,
        call_timeout_s: float = 10.0,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"the browser cannot render as {render_mode!r}, wanted 'human', 'rgb_array' or nothing")
        self.package = Package.of(task, action_space_config, field_extractor, reward_processor)
        self.action_space_config = self.package.action_space_config
        self.action_space = self.package.action_space
        self.observation_space = self.package.observation_space
        self.render_mode = render_mode
        self.data_mode, self.record_screenshots = checked_mode(data_mode), record_screenshots
        self._page: Elements | None = None
        self._fields: Fields = ()
        self._ending: tuple[float, bool, bool, dict[str, Any]] | None = None
        self._episode = EpisodeSpec(task=task, seed=0)
        self._farm = ChromeFarm(tabs=1, view=ELEMENTS, headless=render_mode != "human", call_timeout_s=call_timeout_s)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Open the page of this seed; `options` may set "data_mode" and "record_screenshots" from now on."""
        super().reset(seed=seed)
        self._heed(options or {})
        drawn = int(self.np_random.integers(SEEDS)) if seed is None else seed
        self._episode = EpisodeSpec(task=self.package.task, seed=drawn, mode=self.data_mode)
        self._ending = None
        observation = self._farm.reset({0: self._episode})[0]
        self._fields = self.package.fields(elements_of(observation))
        return self._observe(observation), self._describe(
            StepResult(raw_reward=0.0, done=False, observation=observation)
        )

    def step(self, action: Wanted | None) -> tuple[Observed, float, bool, bool, dict[str, Any]]:
        """Act, once; None does nothing. A step after the end acts on nothing and tells of the end again."""
        if self._page is None:
            raise gymnasium.error.ResetNeeded("MiniWoB.step() was called before reset()")
        if self._ending is not None:
            reward, terminated, truncated, info = self._ending
            return self.package.blank(), reward, terminated, truncated, dict(info)
        command = self.package.command(action, self._page, self._fields)
        result = self._farm.step({0: command})[0]
        info = self._describe(result)
        reward = float(self.package.reward_processor(info))
        if result.done or result.lost:
            self._ending = reward, result.done, bool(result.lost), info
        observed = self.package.blank() if result.observation is None else self._observe(result.observation)
        return observed, reward, result.done, bool(result.lost), info

    def render(self) -> NDArray[np.uint8] | None:
        """A screenshot of the task for "rgb_array"; otherwise nothing, a window shows itself."""
        return self._screenshot() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._farm.close()

    def create_action(self, action_type: Any, **values: Any) -> dict[str, Any]:
        """An action of this type (its name or index), the rest drawn at random unless given."""
        return self.package.create_action(self.action_space, action_type, values)

    def set_data_mode(self, mode: str) -> None:
        """From the next episode on."""
        self.data_mode = checked_mode(mode)

    def set_record_screenshots(self, record_screenshots: bool) -> None:
        self.record_screenshots = record_screenshots

    def _heed(self, options: Mapping[str, Any]) -> None:
        unknown = set(options) - set(OPTIONS)
        if unknown:
            raise ValueError(f"reset got option {min(unknown)!r}, wanted {' or '.join(OPTIONS)}")
        self.set_data_mode(options.get("data_mode", self.data_mode))
        self.set_record_screenshots(bool(options.get("record_screenshots", self.record_screenshots)))

    def _observe(self, observation: Observation) -> Observed:
        self._page = elements_of(observation)
        return self.package.observe(self._page, self._fields, self._screenshot() if self.record_screenshots else None)

    def _describe(self, result: StepResult) -> dict[str, Any]:
        info = {**self.package.ending(result), "seed": self._episode.seed}
        if result.lost:
            info["lost"] = result.lost
        if result.observation is not None:
            info["root_dom"] = root_dom(elements_of(result.observation))
        return info

    def _screenshot(self) -> NDArray[np.uint8]:
        return self._farm.screenshots([0], *self.package.size)[0]


def elements_of(observation: Observation) -> Elements:
    assert isinstance(observation.page, Elements), "the farm was opened with another view"
    return observation.page


def checked_mode(mode: str) -> str:
    if mode not in MODES:
        raise ValueError(f"data_mode is {mode!r}, wanted one of: {', '.join(MODES)}")
    return mode
