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
from browser_farm.gym.adapter import ActionDict, Fields, MiniWoBAdapter, ObservationDict
from browser_farm.gym.elements import ELEMENTS
from browser_farm.gym.slot import EnvSlot, ResetOptions, checked_render_mode

StepTuple = tuple[ObservationDict, float, bool, bool, dict[str, Any]]


class MiniWoB(gymnasium.Env[ObservationDict, ActionDict]):
    """One task in one tab of a Chrome of its own.

    Differences to the package's environment:
    - Wall-clock time has no effect: rewards do not shrink, no episode times out, `info` has no "elapsed".
    - Every page is as if newly loaded.
    - Screenshots are taken only if `record_screenshots` is set.
    - An episode lost to a browser failure is `truncated`, with the cause in `info["lost"]`, and the next reset works.

    `info["seed"]` is the page's seed: `reset(seed=...)` shows exactly that page, and `reset()` samples a seed from the
    environment's own generator.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 4}  # noqa: RUF012 (as declared)

    def __init__(
        self,
        task: str,
        *,
        render_mode: str | None = None,
        action_space_config: Any = "all_supported",  # name of a preset, or the package's ActionSpaceConfig
        field_extractor: Callable[[str], Fields] | None = None,
        reward_processor: Callable[[Mapping[str, Any]], float] | None = None,
        data_mode: str = "train",
        record_screenshots: bool = False,
        root_dom: bool = True,  # False omits the tree of DOMElement from `info`, which saves time
        trusted: bool = False,  # coordinates and keys as Chrome's native input, like the package's: slower
        call_timeout_s: float = 10.0,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        self.adapter = MiniWoBAdapter.of(task, action_space_config, field_extractor, reward_processor)
        self.action_space_config = self.adapter.action_space_config
        self.action_space, self.observation_space = self.adapter.action_space, self.adapter.observation_space
        self._options = ResetOptions(data_mode=data_mode, record_screenshots=record_screenshots)
        self._with_dom = root_dom
        self._slot = EnvSlot(self.adapter)
        self._final: tuple[float, bool, bool, dict[str, Any]] | None = None  # of the step that ended the episode
        self._farm = ChromeFarm(
            tabs=1, view=ELEMENTS, headless=render_mode != "human", trusted=trusted, call_timeout_s=call_timeout_s
        )

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """Open the page of this seed; `options` may set "data_mode" and "record_screenshots" from now on."""
        super().reset(seed=seed)
        self._options = self._options.updated(options)
        episode = self._slot.sample_episode(self.np_random, self._options, seed)
        self._slot.begin(self._farm.reset({0: episode})[0])
        self._final = None
        return self._observe(), self._slot.info(with_dom=self._with_dom)

    def step(self, action: ActionDict | None) -> StepTuple:
        """Perform one action; None waits. After the end of an episode, a step only returns its last result again."""
        if self._final is not None:
            reward, terminated, truncated, info = self._final
            return self._observe(), reward, terminated, truncated, dict(info)
        if self._slot.page is None:
            raise gymnasium.error.ResetNeeded("MiniWoB.step() was called before reset()")
        result = self._farm.step({0: self._slot.command(action)})[0]
        self._slot.advance(result)
        info = self._slot.info(result, with_dom=self._with_dom)
        reward, truncated = float(self.adapter.reward_processor(info)), bool(result.lost)
        if result.done or truncated:
            self._final = reward, result.done, truncated, dict(info)
        return self._observe(), reward, result.done, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """A screenshot of the task for "rgb_array", else None: in "human" mode the window itself is visible."""
        return self._screenshot() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._farm.close()

    def create_action(self, action_type: Any, **values: Any) -> dict[str, Any]:
        """An action of this type (its name or index); fields without a given value are sampled."""
        return self.adapter.create_action(self.action_space, action_type, values)

    def set_data_mode(self, mode: str) -> None:
        """Change the data mode, from the next episode on."""
        self._options = replace(self._options, data_mode=mode)

    def set_record_screenshots(self, record_screenshots: bool) -> None:
        self._options = replace(self._options, record_screenshots=record_screenshots)

    def _observe(self) -> ObservationDict:
        wanted = self._options.record_screenshots and self._slot.page is not None
        return self._slot.observation(self._screenshot() if wanted else None)

    def _screenshot(self) -> NDArray[np.uint8]:
        return self._farm.screenshots([0], *self.adapter.size)[0]
