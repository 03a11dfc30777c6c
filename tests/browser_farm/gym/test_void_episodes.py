"""An episode that a broken browser has ended is void in both environments: truncated, with its cause, no reward."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from browser_farm.gym.elements import decode_elements
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector
from giirl_core.types import Command, EpisodeSpec, Goal, Observation, StepResult

PAGE = [["Click the button.", None], ["body"], [""], [None], [""], [""], [1, -1, 0, 0, 0], [0.0, 0.0, 9.0, 9.0], [""]]


class FaultyFarm:
    """Stands in for Chrome: loses the episodes with seeds in `lost`, and never opens the pages in `closed`."""

    def __init__(self) -> None:
        self.lost: set[int] = set()
        self.closed: set[int] = set()
        self.unopened: dict[int, str] = {}
        self.seeds: dict[int, int] = {}

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        self.unopened.clear()
        return self._open(episodes)

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        self.unopened.clear()
        results = {}
        for tab, command in commands.items():
            lost = "tab_crashed" if self.seeds[tab] in self.lost else ""
            opened = self._open({tab: command.following}) if command.following else {}
            results[tab] = StepResult(raw_reward=0.0, done=not lost, observation=opened.get(tab), lost=lost)
        return results

    def _open(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        opened = {}
        for tab, episode in episodes.items():
            self.seeds[tab] = episode.seed
            if episode.seed in self.closed:
                self.unopened[tab] = f"seed {episode.seed} does not open"
            else:
                page = decode_elements(PAGE)
                opened[tab] = Observation(episode=episode, page=page, goal=Goal("Click the button."))
        return opened

    def close(self) -> None:
        """Nothing is open."""


@pytest.fixture
def farm(monkeypatch: pytest.MonkeyPatch) -> FaultyFarm:
    made = FaultyFarm()
    for module in ("env", "vector_env"):
        monkeypatch.setattr(f"browser_farm.gym.{module}.open_farm", lambda *_, **__: made)
    return made


def always_minus_one(info: Mapping[str, Any]) -> float:
    return -1.0


def test_a_lost_episode_has_no_reward_whatever_the_reward_processor_says(farm: FaultyFarm) -> None:
    env = MiniWoB("click-test", reward_processor=always_minus_one)
    farm.lost = {3}
    env.reset(seed=3)
    for _ in range(2):
        _, reward, terminated, truncated, info = env.step(None)
        assert (reward, terminated, truncated, info["lost"]) == (0.0, False, True, "tab_crashed")
    env.reset(seed=4)
    assert env.step(None)[1:4] == (-1.0, True, False)


def test_a_page_that_does_not_open_is_an_error_of_reset_and_the_next_reset_works(farm: FaultyFarm) -> None:
    env = MiniWoB("click-test")
    farm.closed = {3}
    with pytest.raises(RuntimeError, match="seed 3 does not open"):
        env.reset(seed=3)
    assert env.reset(seed=4)[1]["seed"] == 4


def test_a_lost_episode_of_a_vector_has_no_reward_and_the_others_keep_theirs(farm: FaultyFarm) -> None:
    envs = MiniWoBVector("click-test", 2, reward_processor=always_minus_one)
    farm.lost = {3}
    envs.reset(seed=[3, 4])
    _, rewards, terminated, truncated, infos = envs.step([None, None])
    assert (rewards.tolist(), terminated.tolist(), truncated.tolist()) == ([0.0, -1.0], [False, True], [True, False])
    assert infos["lost"][0] == "tab_crashed"
    assert list(infos["_lost"]) == [True, False]


def test_a_page_of_a_vector_that_does_not_open_is_a_lost_episode_and_another_one_follows(farm: FaultyFarm) -> None:
    envs = MiniWoBVector("click-test", 2, reward_processor=always_minus_one)
    envs.reset(seed=5)
    follower = int(np.random.default_rng(5).integers(2**31))
    farm.closed = {follower}
    assert envs.step([None, None])[2].tolist() == [True, True]
    _, rewards, terminated, truncated, infos = envs.step([None, None])
    assert (rewards.tolist(), terminated.tolist(), truncated.tolist()) == ([0.0, 0.0], [False, False], [True, False])
    assert infos["lost"][0] == f"seed {follower} does not open"
    assert infos["seed"][0] == follower
    observation, _, _, truncated, infos = envs.step([None, None])
    assert not truncated.any()
    assert len(observation["dom_elements"][0]) == 1
    assert infos["seed"][0] != follower


@pytest.mark.parametrize("seed", [np.int64(7), np.uint8(7), np.array(7)])
def test_every_kind_of_integer_is_a_seed(farm: FaultyFarm, seed: Any) -> None:
    assert MiniWoB("click-test").reset(seed=seed)[1]["seed"] == 7
    envs = MiniWoBVector("click-test", 2)
    assert list(envs.reset(seed=seed)[1]["seed"]) == [7, 8]
    assert list(envs.reset(seed=np.array([7, 2]))[1]["seed"]) == [7, 2]
    assert envs.reset(seed=[seed, None])[1]["seed"][0] == 7
    assert list(envs.reset(seed=2**70)[1]["seed"]) == [2**70, 2**70 + 1]


@pytest.mark.parametrize("seed", [4.0, "4", [1.5, 2]])
def test_another_seed_is_refused(farm: FaultyFarm, seed: Any) -> None:
    with pytest.raises(TypeError, match="wanted an integer"):
        MiniWoBVector("click-test", 2).reset(seed=seed)
