"""K MiniWoB++ episodes at once in the tabs of one Chrome, as a Gymnasium vector environment.

`import browser_farm`, then `gymnasium.make_vec("giirl/MiniWoB-v0", num_envs=8, task="click-test")`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, SupportsIndex

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate
from numpy.typing import NDArray

from browser_farm.gym.adapter import ActionDict, Fields, MiniWoBAdapter, ObservationDict
from browser_farm.gym.launch import checked_render_mode, is_due, open_farm
from browser_farm.gym.slot import RESET_RESULT, EnvSlot, ResetOptions, checked_seed
from giirl_core.config.sections import Sandbox
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult

Flags = NDArray[np.bool_]


class VectorSlot(EnvSlot):
    """A slot whose episodes follow one another without a reset."""

    def __init__(self, adapter: MiniWoBAdapter, *, agent_page: bool = False) -> None:
        super().__init__(adapter, agent_page=agent_page)
        self.rng, _ = np_random(None)
        self.following: EpisodeSpec | None = None  # the episode that the farm opens when this one ends
        self.opened: Observation | None = None  # its first observation, once the farm has opened it
        self.steps = 0


class MiniWoBVector(VectorEnv[ObservationDict, Any, NDArray[Any]]):
    """`num_envs` environments like `browser_farm.gym.env.MiniWoB`; a step of all of them is one call to each tab.

    `task` is one task for all environments, or a list that is assigned to them in turn. Episodes restart by themselves
    one step after their end (`AutoresetMode.NEXT_STEP`). The next page is opened by the step that ends an episode, so
    a restart costs no call; in real time the restart itself opens it. `infos` holds trees of the package's DOMElement
    only if `root_dom` is set. The other arguments are those of `MiniWoB`.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as declared)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 4,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        task: str | Sequence[str],
        num_envs: int = 8,
        *,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        base_url: str | None = None,
        action_space_config: Any = "all_supported",
        field_extractor: Callable[[str], Fields] | None = None,
        reward_processor: Callable[[Mapping[str, Any]], float] | None = None,
        wait_ms: float = 0.0,
        block_on_reset: bool = True,
        refresh_freq: int = 0,
        data_mode: str = "train",
        real_time: bool = False,
        record_screenshots: bool | None = None,
        root_dom: bool = False,
        agent_page: bool = False,
        trusted: bool = False,
        call_timeout_s: float = 10.0,
        chrome_sandbox: Sandbox = "auto",
    ) -> None:
        del block_on_reset
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        if num_envs < 1 or (max_episode_steps is not None and max_episode_steps < 1):
            raise ValueError(f"num_envs is {num_envs}, max_episode_steps {max_episode_steps}: wanted at least 1")
        tasks = [task] if isinstance(task, str) else list(task)
        adapters = [
            MiniWoBAdapter.of(each, action_space_config, field_extractor, reward_processor, base_url or "")
            for each in tasks
        ]
        if len({adapter.size for adapter in adapters}) != 1:
            raise ValueError(f"the pages of {', '.join(tasks)} differ in size: wanted tasks with the same spaces")
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
        self.single_action_space, self.single_observation_space = (
            adapters[0].action_space,
            adapters[0].observation_space,
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._slots = [VectorSlot(adapters[index % len(adapters)], agent_page=agent_page) for index in range(num_envs)]
        screenshots = real_time if record_screenshots is None else record_screenshots
        self._options = ResetOptions(data_mode=data_mode, record_screenshots=screenshots)
        self._with_dom, self._real_time, self._refresh_freq = root_dom, real_time, refresh_freq
        self._farm = open_farm(
            tasks,
            num_envs,
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
        self,
        *,
        seed: SupportsIndex | Sequence[SupportsIndex | None] | NDArray[np.integer] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """Open a page in each slot: of the seeds given, of `seed`, `seed + 1`, ..., or of sampled seeds.

        RuntimeError for a page that does not open.
        """
        self._options = self._options.updated(options)
        episodes = {}
        for index, (slot, page_seed) in enumerate(zip(self._slots, self._page_seeds(seed), strict=True)):
            if page_seed is not None:
                slot.rng, _ = np_random(page_seed)
            slot.page = slot.opened = None
            slot.following = episodes[index] = slot.sample_episode(slot.rng, self._options, page_seed)
        self._begin(self._open(episodes))
        for reason in self._farm.unopened.values():
            raise RuntimeError(reason)
        infos = {index: slot.info(with_dom=self._with_dom) for index, slot in enumerate(self._slots)}
        return self._observe(), self._merge_infos(infos)

    def step(self, actions: Any) -> tuple[ObservationDict, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Act in each slot. `actions` is a batch from the action space, or a list with one action per slot."""
        per_slot = actions if isinstance(actions, (list, tuple)) else list(iterate(self.action_space, actions))
        if len(per_slot) != self.num_envs:
            raise ValueError(f"step got {len(per_slot)} actions, wanted one for each of {self.num_envs} environments")
        running = [index for index, slot in enumerate(self._slots) if slot.page is not None]
        results = self._farm.step({index: self._command(self._slots[index], per_slot[index]) for index in running})
        restarted = [index for index in range(self.num_envs) if index not in results]
        lost = self._restart(restarted)
        rewards = np.zeros(self.num_envs, dtype=np.float64)
        terminated, truncated = np.zeros((2, self.num_envs), dtype=np.bool_)
        truncated[list(lost)] = True
        infos = {
            index: self._slots[index].info(lost.get(index, RESET_RESULT), with_dom=self._with_dom)
            for index in restarted
        }
        for index, result in results.items():
            slot = self._slots[index]
            terminated[index], truncated[index] = result.done, self._advance(slot, result)
            infos[index] = slot.info(result, with_dom=self._with_dom, elapsed=self._real_time)
            rewards[index] = slot.reward(infos[index])
        observation = self._observe()
        for slot, cut_off in zip(self._slots, truncated, strict=True):
            if cut_off:
                slot.page = None
        return observation, rewards, terminated, truncated, self._merge_infos(infos)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Screenshots of all slots for "rgb_array", else None: in "human" mode the window itself is visible."""
        return tuple(self._screenshots(range(self.num_envs)).values()) if self.render_mode == "rgb_array" else None

    def close_extras(self, **kwargs: Any) -> None:
        del kwargs
        self._farm.close()

    def _begin(self, observations: Mapping[int, Observation]) -> None:
        for index, observation in observations.items():
            slot = self._slots[index]
            slot.begin(observation)
            slot.steps, slot.following, slot.opened = 0, None, None

    def _command(self, slot: VectorSlot, action: ActionDict | None) -> Command:
        slot.following = slot.following or slot.sample_episode(slot.rng, self._options)
        # In real time the clock of a page runs from when it is opened.
        ahead = not self._real_time and not is_due(self._refresh_freq, slot.episodes + 1)
        return slot.command(action, slot.following if ahead else None)

    def _restart(self, finished: Sequence[int]) -> dict[int, StepResult]:
        """Begin the next episode of finished slots, with the page that is already open or by opening it now.

        An episode whose page does not open is lost; its result is returned, and another one follows it.
        """
        pages = {index: page for index in finished if (page := self._slots[index].opened)}
        missing = {index: next for index in finished if index not in pages and (next := self._slots[index].following)}
        if len(pages) + len(missing) < len(finished):
            raise ResetNeeded("MiniWoBVector.step() was called before reset()")
        self._begin({**pages, **self._open(missing)})
        lost = {index: reason for index, reason in self._farm.unopened.items() if index in missing}
        for index in lost:
            slot = self._slots[index]
            slot.seed, slot.following = missing[index].seed, slot.sample_episode(slot.rng, self._options)
        return {i: StepResult(raw_reward=0.0, done=False, observation=None, lost=reason) for i, reason in lost.items()}

    def _open(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        for index in episodes:
            if is_due(self._refresh_freq, self._slots[index].episodes + 1):
                self._farm.refresh(index)
        return self._farm.reset(episodes)

    def _page_seeds(self, seed: Any) -> list[int | None]:
        """One seed for each environment; None for those that are to be sampled."""
        if seed is None:
            return [None] * self.num_envs
        if np.ndim(seed) == 0:
            return [checked_seed(seed) + index for index in range(self.num_envs)]
        seeds = [None if one is None else checked_seed(one) for one in seed]
        if len(seeds) != self.num_envs:
            raise ValueError(f"reset got {len(seeds)} seeds, wanted one for each of {self.num_envs} environments")
        return seeds

    def _advance(self, slot: VectorSlot, result: StepResult) -> bool:
        """Take over the result of an action; returns whether the episode is truncated."""
        slot.advance(result)
        slot.steps += 1
        if slot.page is None:
            slot.opened = result.observation
        return bool(result.lost) or (slot.steps == self.max_episode_steps and not result.done)

    def _observe(self) -> ObservationDict:
        visible = [index for index, slot in enumerate(self._slots) if slot.page is not None]
        screenshots = self._screenshots(visible) if self._options.record_screenshots else {}
        single = [slot.observation(screenshots.get(index)) for index, slot in enumerate(self._slots)]
        batch: ObservationDict = {
            key: tuple(one[key] for one in single) for key in ("utterance", "dom_elements", "fields")
        }
        black = np.zeros(self.observation_space["screenshot"].shape, dtype=np.uint8)  # type: ignore[index]
        return {**batch, "screenshot": np.stack([one["screenshot"] for one in single]) if screenshots else black}

    def _screenshots(self, slots: Sequence[int]) -> dict[int, NDArray[np.uint8]]:
        return self._farm.screenshots(slots, *self._slots[0].adapter.size)

    def _merge_infos(self, infos: Mapping[int, dict[str, Any]]) -> dict[str, Any]:
        merged: dict[str, Any] = {}
        for index, info in infos.items():
            merged = self._add_info(merged, {key: value for key, value in info.items() if key != "seed"}, index)
        seeds = np.array([infos[index]["seed"] for index in range(self.num_envs)])  # objects beyond 64 bits
        return {**merged, "seed": seeds, "_seed": np.ones(self.num_envs, dtype=np.bool_)}
