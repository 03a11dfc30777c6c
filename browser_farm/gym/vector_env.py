"""K MiniWoB++ episodes at once in the tabs of one Chrome, as a Gymnasium vector environment.

`import browser_farm`, then `gymnasium.make_vec("giirl/MiniWoB-v0", num_envs=8, task="click-test")`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, iterate
from numpy.typing import NDArray

from browser_farm.farm import ChromeFarm
from browser_farm.gym.adapter import Fields, MiniWoBAdapter, Observed, Wanted
from browser_farm.gym.elements import ELEMENTS
from browser_farm.gym.slot import EnvSlot, ResetOptions, checked_render_mode
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult

Flags = NDArray[np.bool_]


class VectorSlot(EnvSlot):
    """A place whose episodes follow one another."""

    def __init__(self, package: MiniWoBAdapter) -> None:
        super().__init__(package)
        self.generator, _ = np_random(None)
        self.following: EpisodeSpec | None = None  # what the farm opens when this episode ends
        self.opened: Observation | None = None  # and its page, once the farm has
        self.steps = 0


class MiniWoBVector(VectorEnv[Observed, Any, NDArray[Any]]):
    """As `browser_farm.gym.env.MiniWoB` in each place; a step of all of them costs one call to each tab.

    `task` is one for all, or a list that is dealt out in turn. Episodes restart by themselves, one step after they
    ended (`AutoresetMode.NEXT_STEP`); the next page is opened along with the step that ends an episode, so that
    restarting costs no call. `infos` holds trees of the package's DOMElement only where `root_dom` asks for them.
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
        action_space_config: Any = "all_supported",
        field_extractor: Callable[[str], Fields] | None = None,
        reward_processor: Callable[[Mapping[str, Any]], float] | None = None,
        data_mode: str = "train",
        record_screenshots: bool = False,
        root_dom: bool = False,
        trusted: bool = False,
        call_timeout_s: float = 10.0,
    ) -> None:
        self.render_mode = checked_render_mode(render_mode, self.metadata["render_modes"])
        if num_envs < 1 or (max_episode_steps is not None and max_episode_steps < 1):
            raise ValueError(f"num_envs is {num_envs}, max_episode_steps {max_episode_steps}: wanted at least 1")
        tasks = [task] if isinstance(task, str) else list(task)
        packages = [MiniWoBAdapter.of(each, action_space_config, field_extractor, reward_processor) for each in tasks]
        if len({package.size for package in packages}) != 1:
            raise ValueError(f"the pages of {', '.join(tasks)} differ in size: wanted tasks that share a space")
        self.num_envs, self.max_episode_steps = num_envs, max_episode_steps
        self.single_action_space, self.single_observation_space = (
            packages[0].action_space,
            packages[0].observation_space,
        )
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._places = [VectorSlot(packages[at % len(packages)]) for at in range(num_envs)]
        self._conduct = ResetOptions(data_mode=data_mode, record_screenshots=record_screenshots)
        self._tree = root_dom
        self._farm = ChromeFarm(
            tabs=num_envs,
            view=ELEMENTS,
            headless=render_mode != "human",
            trusted=trusted,
            call_timeout_s=call_timeout_s,
        )

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observed, dict[str, Any]]:
        """Open a page in each place: of the seeds given, of `seed`, `seed + 1`, ..., or of what each draws."""
        self._conduct = self._conduct.updated(options)
        seeds = [seed + at for at in range(self.num_envs)] if isinstance(seed, int) else seed or [None] * self.num_envs
        if len(seeds) != self.num_envs:
            raise ValueError(f"reset got {len(seeds)} seeds, wanted one for each of {self.num_envs} environments")
        episodes = {}
        for at, (place, each) in enumerate(zip(self._places, seeds, strict=True)):
            if each is not None:
                place.generator, _ = np_random(each)
            episodes[at] = place.draw(place.generator, self._conduct, each)
        self._begin(self._farm.reset(episodes))
        return self._observed(), self._together({at: place.info(tree=self._tree) for at, place in self._numbered()})

    def step(self, actions: Any) -> tuple[Observed, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Act in each place. `actions` are of the action space, or a list with an action for each place."""
        each = actions if isinstance(actions, (list, tuple)) else list(iterate(self.action_space, actions))
        if len(each) != self.num_envs:
            raise ValueError(f"step got {len(each)} actions, wanted one for each of {self.num_envs} environments")
        going_on = [at for at, place in self._numbered() if place.page is not None]
        results = self._farm.step({at: self._command(self._places[at], each[at]) for at in going_on})
        self._restart([at for at, _ in self._numbered() if at not in results])
        rewards = np.zeros(self.num_envs, dtype=np.float64)
        terminated, truncated = np.zeros((2, self.num_envs), dtype=np.bool_)
        infos = {at: place.info(tree=self._tree) for at, place in self._numbered() if at not in results}
        for at, result in results.items():
            place = self._places[at]
            terminated[at], truncated[at] = result.done, self._advance(place, result)
            infos[at] = place.info(result, tree=self._tree)
            rewards[at] = place.package.reward_processor(infos[at])
        observed = self._observed()
        for place, cut in zip(self._places, truncated, strict=True):
            if cut:
                place.page = None
        return observed, rewards, terminated, truncated, self._together(infos)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Screenshots of all places for "rgb_array"; otherwise nothing, a window shows itself."""
        return tuple(self._pictures(range(self.num_envs)).values()) if self.render_mode == "rgb_array" else None

    def close_extras(self, **kwargs: Any) -> None:
        del kwargs
        self._farm.close()

    def _numbered(self) -> list[tuple[int, VectorSlot]]:
        return list(enumerate(self._places))

    def _begin(self, observations: Mapping[int, Observation]) -> None:
        for at, observation in observations.items():
            place = self._places[at]
            place.begin(observation)
            place.steps, place.following, place.opened = 0, None, None

    def _command(self, place: VectorSlot, action: Wanted | None) -> Command:
        place.following = place.following or place.draw(place.generator, self._conduct)
        return place.command(action, place.following)

    def _restart(self, over: Sequence[int]) -> None:
        """Begin an episode where one has ended: with the page that is already there, or with one still to be opened."""
        there = {at: self._places[at].opened for at in over}
        missing = {at: self._places[at].following for at, page in there.items() if page is None}
        if None in missing.values():
            raise ResetNeeded("MiniWoBVector.step() was called before reset()")
        opened = self._farm.reset({at: episode for at, episode in missing.items() if episode})
        self._begin({**{at: page for at, page in there.items() if page}, **opened})

    def _advance(self, place: VectorSlot, result: StepResult) -> bool:
        """Show what an action led to; True where that cuts the episode off."""
        place.advance(result)
        place.steps += 1
        if place.page is None:
            place.opened = result.observation
        return bool(result.lost) or (place.steps == self.max_episode_steps and not result.done)

    def _observed(self) -> Observed:
        shown = [at for at, place in self._numbered() if place.page is not None]
        pictures = self._pictures(shown) if self._conduct.record_screenshots else {}
        each = [place.observed(pictures.get(at)) for at, place in self._numbered()]
        blank = np.zeros(self.observation_space["screenshot"].shape, dtype=np.uint8)  # type: ignore[index]
        batch: Observed = {key: tuple(one[key] for one in each) for key in ("utterance", "dom_elements", "fields")}
        return {**batch, "screenshot": np.stack([one["screenshot"] for one in each]) if pictures else blank}

    def _pictures(self, places: Sequence[int]) -> dict[int, NDArray[np.uint8]]:
        return self._farm.screenshots(places, *self._places[0].package.size)

    def _together(self, infos: Mapping[int, dict[str, Any]]) -> dict[str, Any]:
        together: dict[str, Any] = {}
        for at, info in infos.items():
            together = self._add_info(together, info, at)
        return together
