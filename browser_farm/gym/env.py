"""MiniWoB++ as a Gymnasium environment with the miniwob package's own observations and actions.

`import browser_farm`, then `gymnasium.make("giirl/MiniWoB-v0", task="click-test")`, or the path of a task file as task.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, SupportsIndex

import gymnasium
import numpy as np
from numpy.typing import NDArray

from browser_farm.gym.adapter import ActionDict, Fields, MiniWoBAdapter, ObservationDict
from browser_farm.gym.launch import checked_render_mode, checked_task, is_due, open_farm
from browser_farm.gym.slot import EnvSlot, ResetOptions, checked_seed
from giirl_core.config.sections import Sandbox

ATTENTION_CELLS = 20  # rows and columns that core.visualizeAttention can place
StepTuple = tuple[ObservationDict, float, bool, bool, dict[str, Any]]


class MiniWoB(gymnasium.Env[ObservationDict, ActionDict]):
    """One task in one tab of a Chrome of its own.

    Differences to the package's environment:
    - Wall-clock time has no effect: rewards do not shrink, no episode times out, `info` has no "elapsed".
    - Every page is as if newly loaded.
    - Screenshots are taken only if `record_screenshots` is set.
    - An episode lost to a browser failure is `truncated` without a reward, with the cause in `info["lost"]`, and the
      next reset works.

    `real_time` takes back the first and the third: time and screenshots are as in the package. All arguments of the
    package's environment are accepted. `wait_ms` is in the page's own time.

    `info["seed"]` is the page's seed: `reset(seed=...)` shows exactly that page, and `reset()` samples a seed from the
    environment's own generator.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 4}  # noqa: RUF012 (as declared)

    def __init__(
        self,
        task: str | None = None,
        *,
        subdomain: str | None = None,  # the package's name for `task`
        render_mode: str | None = None,
        base_url: str | None = None,  # folder of the pages, as file:// or http:// URL; None for the package's own
        action_space_config: Any = "all_supported",  # name of a preset, or the package's ActionSpaceConfig
        field_extractor: Callable[[str], Fields] | None = None,
        reward_processor: Callable[[Mapping[str, Any]], float] | None = None,
        wait_ms: float = 0.0,  # pause after each action, before the page is read
        block_on_reset: bool = True,  # for the package's sake: a reset always waits until the page is complete
        refresh_freq: int = 0,  # every so many episodes the page is loaded anew
        data_mode: str = "train",
        real_time: bool = False,  # the page's own clock, time limit and time-scaled rewards
        record_screenshots: bool | None = None,  # None: only in real time
        root_dom: bool = True,  # False omits the tree of DOMElement from `info`, which saves time
        agent_page: bool = False,  # "page", "goal" and "action" in `info`, as the agents of this project know them
        trusted: bool = False,  # coordinates and keys as Chrome's native input, like the package's: slower
        call_timeout_s: float = 10.0,
        chrome_sandbox: Sandbox = "auto",
    ) -> None:
        del block_on_reset
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        self.adapter = MiniWoBAdapter.of(
            checked_task(task, subdomain), action_space_config, field_extractor, reward_processor, base_url or ""
        )
        self.action_space_config = self.adapter.action_space_config
        self.action_space, self.observation_space = self.adapter.action_space, self.adapter.observation_space
        screenshots = real_time if record_screenshots is None else record_screenshots
        self._options = ResetOptions(data_mode=data_mode, record_screenshots=screenshots)
        self._with_dom, self._real_time, self._refresh_freq = root_dom, real_time, refresh_freq
        self._slot = EnvSlot(self.adapter, agent_page=agent_page)
        self._final: tuple[float, bool, bool, dict[str, Any]] | None = None  # of the step that ended the episode
        self._farm = open_farm(
            [self.adapter.task],
            1,
            render_mode=render_mode,
            base_url=base_url,
            wait_ms=wait_ms,
            real_time=real_time,
            agent_page=agent_page,
            trusted=trusted,
            call_timeout_s=call_timeout_s,
            chrome_sandbox=chrome_sandbox,
        )

    def reset(
        self, *, seed: SupportsIndex | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """Open the page of this seed; `options` may set "data_mode" and "record_screenshots" from now on.

        RuntimeError for a page that does not open.
        """
        page_seed = None if seed is None else checked_seed(seed)
        super().reset(seed=page_seed)
        self._options = self._options.updated(options)
        episode = self._slot.sample_episode(self.np_random, self._options, page_seed)
        if is_due(self._refresh_freq, self._slot.episodes + 1):
            self._farm.refresh(0)
        self._slot.page = self._final = None
        for observation in self._farm.reset({0: episode}).values():
            self._slot.begin(observation)
        for reason in self._farm.unopened.values():
            raise RuntimeError(reason)
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
        info = self._slot.info(result, with_dom=self._with_dom, elapsed=self._real_time)
        reward, truncated = self._slot.reward(info), bool(result.lost)
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

    def visualize_attention(self, attention: NDArray[Any] | Sequence[Sequence[float]] | None) -> None:
        """Draw weights [rows, columns] from 0 to 1, at most 20 x 20, on a canvas beside the task, until the next reset.

        Without rows the drawing is cleared; None does nothing.
        """
        if attention is None:
            return
        if self._slot.page is None and self._final is None:
            raise gymnasium.error.ResetNeeded("MiniWoB.visualize_attention() was called before reset()")
        weights = np.asarray(attention, dtype=np.float64)
        if weights.size and (weights.ndim != 2 or max(weights.shape) > ATTENTION_CELLS):
            most = f"{ATTENTION_CELLS} x {ATTENTION_CELLS}"
            raise ValueError(f"the attention has the shape {weights.shape}: wanted rows and columns, at most {most}")
        rows = weights.tolist() if weights.size else []
        self._farm.run_script(0, f"core.visualizeAttention({json.dumps(rows)});''")

    def _observe(self) -> ObservationDict:
        wanted = self._options.record_screenshots and self._slot.page is not None
        return self._slot.observation(self._screenshot() if wanted else None)

    def _screenshot(self) -> NDArray[np.uint8]:
        return self._farm.screenshots([0], *self.adapter.size)[0]
