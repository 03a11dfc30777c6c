"""MiniWoB++ as a Gymnasium environment with the miniwob package's own observations and actions.

`import browser_farm`, then `gymnasium.make("giirl/MiniWoB-v0", task="click-test")`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from browser_farm.farm import ChromeFarm
from browser_farm.gym.adapter import Fields, MiniWoBAdapter, Observed, Wanted
from browser_farm.gym.elements import ELEMENTS
from browser_farm.gym.slot import EnvSlot, ResetOptions, checked_render_mode

Told = tuple[Observed, float, bool, bool, dict[str, Any]]


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
        root_dom: bool = True,  # False leaves the tree of DOMElement out of `info`, and saves its making
        trusted: bool = False,  # coordinates and keys through Chrome's own input, as the package sends them: slower
        call_timeout_s: float = 10.0,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        self.package = MiniWoBAdapter.of(task, action_space_config, field_extractor, reward_processor)
        self.action_space_config = self.package.action_space_config
        self.action_space, self.observation_space = self.package.action_space, self.package.observation_space
        self._conduct = ResetOptions(data_mode=data_mode, record_screenshots=record_screenshots)
        self._tree = root_dom
        self._place = EnvSlot(self.package)
        self._ending: tuple[float, bool, bool, dict[str, Any]] | None = None
        self._farm = ChromeFarm(
            tabs=1, view=ELEMENTS, headless=render_mode != "human", trusted=trusted, call_timeout_s=call_timeout_s
        )

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Open the page of this seed; `options` may set "data_mode" and "record_screenshots" from now on."""
        super().reset(seed=seed)
        self._conduct = self._conduct.updated(options)
        self._place.begin(self._farm.reset({0: self._place.draw(self.np_random, self._conduct, seed)})[0])
        self._ending = None
        return self._observed(), self._place.info(tree=self._tree)

    def step(self, action: Wanted | None) -> Told:
        """Act, once; None does nothing. A step after the end acts on nothing and tells of the end again."""
        if self._ending is not None:
            reward, terminated, truncated, info = self._ending
            return self._observed(), reward, terminated, truncated, dict(info)
        if self._place.page is None:
            raise gymnasium.error.ResetNeeded("MiniWoB.step() was called before reset()")
        result = self._farm.step({0: self._place.command(action)})[0]
        self._place.advance(result)
        info = self._place.info(result, tree=self._tree)
        reward, truncated = float(self.package.reward_processor(info)), bool(result.lost)
        if result.done or truncated:
            self._ending = reward, result.done, truncated, dict(info)
        return self._observed(), reward, result.done, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """A screenshot of the task for "rgb_array"; otherwise nothing, a window shows itself."""
        return self._picture() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._farm.close()

    def create_action(self, action_type: Any, **values: Any) -> dict[str, Any]:
        """An action of this type (its name or its index), drawn at random but for the values given."""
        return self.package.create_action(self.action_space, action_type, values)

    def set_data_mode(self, mode: str) -> None:
        """From the next episode on."""
        self._conduct = replace(self._conduct, data_mode=mode)

    def set_record_screenshots(self, record_screenshots: bool) -> None:
        self._conduct = replace(self._conduct, record_screenshots=record_screenshots)

    def _observed(self) -> Observed:
        wanted = self._conduct.record_screenshots and self._place.page is not None
        return self._place.observed(self._picture() if wanted else None)

    def _picture(self) -> NDArray[np.uint8]:
        return self._farm.screenshots([0], *self.package.size)[0]
