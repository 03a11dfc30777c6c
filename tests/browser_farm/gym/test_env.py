"""The Gymnasium environments on a real Chrome, single and vectorised."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import browser_farm  # noqa: F401 (registers the environment)
from benchmarks.gym_equality import differences
from browser_farm.chrome import reaper
from browser_farm.farm import ChromeFarm
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector

pytestmark = pytest.mark.chrome

TASKS = ["click-button", "enter-text"]
NUM_ENVS = 2
MAX_STEPS = 4


def tenfold(info: Mapping[str, Any]) -> float:
    return 10.0 * float(info["raw_reward"])


@pytest.fixture(scope="module")
def env() -> Iterator[MiniWoB]:
    made = gymnasium.make("giirl/MiniWoB-v0", task="click-button", reward_processor=tenfold).unwrapped
    assert isinstance(made, MiniWoB)
    yield made
    made.close()


@pytest.fixture(scope="module")
def envs() -> Iterator[MiniWoBVector]:
    made = gymnasium.make_vec(
        "giirl/MiniWoB-v0", num_envs=NUM_ENVS, task=TASKS, max_episode_steps=MAX_STEPS, root_dom=True
    )
    assert isinstance(made, MiniWoBVector)
    yield made
    made.close()


def click_button(env: MiniWoB, observation: dict[str, Any], *, right: bool) -> dict[str, Any]:
    """An action on the first button that the instruction names, or on the first other one."""
    wanted = dict(observation["fields"])["target"]
    ref = next(e["ref"] for e in observation["dom_elements"] if e["tag"] == "button" and (e["text"] == wanted) == right)
    return env.create_action("CLICK_ELEMENT", ref=ref)


def kill_browser(farm: object) -> None:
    assert isinstance(farm, ChromeFarm)
    for pid in reaper.processes(Path(farm.chrome_directory)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


# ---- a single environment


@pytest.mark.filterwarnings("ignore:.*Box action spaces")  # the package's own coordinates are pixels
def test_gymnasium_accepts_the_environment(env: MiniWoB) -> None:
    check_env(env, skip_render_check=True, skip_close_check=True)


def test_the_reward_tells_right_from_wrong_and_later_steps_return_it_again(env: MiniWoB) -> None:
    for right, raw in ((True, 1.0), (False, -1.0)):
        observation, info = env.reset(seed=4)
        assert (info["seed"], info["done"], info["root_dom"].tag) == (4, False, "body")
        observation, reward, terminated, truncated, info = env.step(click_button(env, observation, right=right))
        assert (reward, terminated, truncated) == (10 * raw, True, False)
        assert (info["raw_reward"], info["env_reward"], info["done"]) == (raw, raw, True)
        assert observation["dom_elements"] == ()
        assert env.step(None)[1:4] == (10 * raw, True, False)


def test_the_page_seeds_sampled_after_a_seeded_reset_are_reproducible(env: MiniWoB) -> None:
    def sampled() -> list[int]:
        env.reset(seed=9)
        return [env.reset()[1]["seed"] for _ in range(3)]

    assert sampled() == sampled()
    assert len(set(sampled())) == 3


def test_a_screenshot_is_taken_only_if_requested_and_black_otherwise(env: MiniWoB) -> None:
    black, _ = env.reset(seed=4)
    recorded, _ = env.reset(seed=4, options={"record_screenshots": True})
    env.set_record_screenshots(False)
    assert not black["screenshot"].any()
    assert recorded in env.observation_space
    assert recorded["screenshot"].shape == (210, 160, 3)
    assert len(np.unique(recorded["screenshot"].reshape(-1, 3), axis=0)) > 20
    assert env.render() is None
    assert list(differences({**recorded, "screenshot": None}, {**black, "screenshot": None})) == []


def test_a_killed_browser_truncates_the_episode_and_the_next_reset_works(env: MiniWoB) -> None:
    observation, _ = env.reset(seed=4)
    kill_browser(env._farm)
    observation, reward, terminated, truncated, info = env.step(click_button(env, observation, right=True))
    assert (reward, terminated, truncated, info["lost"]) == (0.0, False, True, "browser_died")
    observation, info = env.reset(seed=4)
    assert "lost" not in info
    assert env.step(click_button(env, observation, right=True))[1] == 10.0


def test_an_unknown_task_starts_no_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("browser_farm.gym.env.open_farm", lambda *_, **__: pytest.fail("started"))
    with pytest.raises(ValueError, match="no MiniWoB task 'click-buton': did you mean 'click-button'"):
        gymnasium.make("giirl/MiniWoB-v0", task="click-buton")
    monkeypatch.setattr("browser_farm.gym.env.open_farm", lambda *_, **__: None)
    unopened = MiniWoB("click-button")
    with pytest.raises(gymnasium.error.ResetNeeded):
        unopened.step(None)


# ---- the vector environment


def random_actions(envs: MiniWoBVector, seed: int) -> Iterator[Any]:
    envs.action_space.seed(seed)
    while True:
        yield envs.action_space.sample()


def test_vector_observations_are_in_the_batched_space(envs: MiniWoBVector) -> None:
    observation, infos = envs.reset(seed=20)
    assert observation in envs.observation_space
    assert list(infos["seed"]) == [20, 21]
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    for _, actions in zip(range(2 * MAX_STEPS), random_actions(envs, 5), strict=False):
        observation, rewards, terminated, truncated, infos = envs.step(actions)
        assert observation in envs.observation_space
        assert rewards.shape == terminated.shape == truncated.shape == (NUM_ENVS,)
        assert (infos["done"] == terminated).all()


def test_each_environment_behaves_like_a_single_one(envs: MiniWoBVector) -> None:
    """Compares observations, rewards, ends and following pages for the same seeds and actions."""
    observation, infos = envs.reset(seed=31)
    singles = [MiniWoB(task) for task in TASKS]
    try:
        expected = [single.reset(seed=31 + index) for index, single in enumerate(singles)]
        steps, finished = [0] * NUM_ENVS, [False] * NUM_ENVS
        for actions in [next(random_actions(envs, seed)) for seed in range(3 * MAX_STEPS)]:
            for index, (one, info) in enumerate(expected):
                assert all(infos[key][index] == info[key] for key in ("seed", "raw_reward", "reason"))
                for key in ("utterance", "fields", "dom_elements"):
                    assert list(differences(observation[key][index], one[key])) == []
            ends = []
            for index, single in enumerate(singles):
                if finished[index]:
                    expected[index], steps[index], reward, done = single.reset(), 0, 0.0, False
                else:
                    action = {key: values[index] for key, values in actions.items()}
                    one, reward, done, _, info = single.step(action)
                    expected[index], steps[index] = (one, info), steps[index] + 1
                finished[index] = done or steps[index] == MAX_STEPS
                ends.append((reward, done, finished[index] and not done))
            observation, rewards, terminated, truncated, infos = envs.step(actions)
            assert list(zip(rewards, terminated, truncated, strict=True)) == ends
    finally:
        for single in singles:
            single.close()


def test_a_step_is_one_call_to_each_tab_and_a_restart_needs_none(
    envs: MiniWoBVector, monkeypatch: pytest.MonkeyPatch
) -> None:
    observation, _ = envs.reset(seed=20)
    calls: list[int] = []
    farm = envs._farm
    assert isinstance(farm, ChromeFarm)
    ask = farm._tabs.ask

    def counting_ask(requests: dict[int, list[Any]], **options: Any) -> Any:
        calls.append(len(requests))
        return ask(requests, **options)

    monkeypatch.setattr(farm._tabs, "ask", counting_ask)
    submit = [next((e["ref"] for e in page if e["tag"] == "button"), 0) for page in observation["dom_elements"]]
    _, _, terminated, _, _ = envs.step([{"action_type": 8, "ref": ref} for ref in submit])
    assert terminated.all()
    observation, rewards, terminated, _, infos = envs.step([None] * NUM_ENVS)
    assert not terminated.any()
    assert not rewards.any()
    assert calls == [NUM_ENVS]
    assert all(len(page) > 3 for page in observation["dom_elements"])
    assert not set(infos["seed"]) & {20, 21}


def test_a_killed_browser_truncates_every_episode_and_all_restart(envs: MiniWoBVector) -> None:
    envs.reset(seed=20)
    kill_browser(envs._farm)
    _, rewards, terminated, truncated, infos = envs.step([None] * NUM_ENVS)
    assert truncated.all()
    assert not terminated.any()
    assert not rewards.any()
    assert list(infos["lost"]) == ["browser_died"] * NUM_ENVS
    observation, _, terminated, truncated, _ = envs.step([None] * NUM_ENVS)
    assert not (terminated | truncated).any()
    assert all(len(page) > 3 for page in observation["dom_elements"])


def test_wrong_numbers_of_actions_or_seeds_and_mixed_page_sizes_are_rejected(envs: MiniWoBVector) -> None:
    envs.reset(seed=20)
    with pytest.raises(ValueError, match="got 1 actions, wanted one for each of 2"):
        envs.step([None])
    with pytest.raises(ValueError, match="got 3 seeds, wanted one for each of 2"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="differ in size"):
        MiniWoBVector(["click-test", "flight.AA"])
