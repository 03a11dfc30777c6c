"""The Gymnasium environments on a real Chrome: one place and many."""

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
PLACES = 2
LIMIT = 4


def tenfold(told: Mapping[str, Any]) -> float:
    return 10.0 * float(told["raw_reward"])


@pytest.fixture(scope="module")
def env() -> Iterator[MiniWoB]:
    made = gymnasium.make("giirl/MiniWoB-v0", task="click-button", reward_processor=tenfold).unwrapped
    assert isinstance(made, MiniWoB)
    yield made
    made.close()


@pytest.fixture(scope="module")
def envs() -> Iterator[MiniWoBVector]:
    made = gymnasium.make_vec("giirl/MiniWoB-v0", num_envs=PLACES, task=TASKS, max_episode_steps=LIMIT, root_dom=True)
    assert isinstance(made, MiniWoBVector)
    yield made
    made.close()


def press_first(env: MiniWoB, observed: dict[str, Any], *, right: bool) -> dict[str, Any]:
    """Press the first button that the instruction names, or the first that it does not."""
    wanted = dict(observed["fields"])["target"]
    ref = next(e["ref"] for e in observed["dom_elements"] if e["tag"] == "button" and (e["text"] == wanted) == right)
    return env.create_action("CLICK_ELEMENT", ref=ref)


def kill_browser(farm: ChromeFarm) -> None:
    for pid in reaper.processes(Path(farm.chrome_directory)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


# ---- one place


@pytest.mark.filterwarnings("ignore:.*Box action spaces")  # the package's own coordinates are pixels
def test_gymnasium_accepts_the_environment(env: MiniWoB) -> None:
    check_env(env, skip_render_check=True, skip_close_check=True)


def test_a_wrong_button_costs_and_the_right_one_pays_and_the_end_is_told_again(env: MiniWoB) -> None:
    for right, raw in ((True, 1.0), (False, -1.0)):
        observed, info = env.reset(seed=4)
        assert (info["seed"], info["done"], info["root_dom"].tag) == (4, False, "body")
        observed, paid, terminated, truncated, info = env.step(press_first(env, observed, right=right))
        assert (paid, terminated, truncated) == (10 * raw, True, False)
        assert (info["raw_reward"], info["env_reward"], info["done"]) == (raw, raw, True)
        assert observed["dom_elements"] == ()
        assert env.step(None)[1:4] == (10 * raw, True, False)


def test_pages_drawn_after_a_seed_are_the_same_each_time(env: MiniWoB) -> None:
    def drawn() -> list[int]:
        env.reset(seed=9)
        return [env.reset()[1]["seed"] for _ in range(3)]

    assert drawn() == drawn()
    assert len(set(drawn())) == 3


def test_a_screenshot_is_taken_when_asked_for_and_black_otherwise(env: MiniWoB) -> None:
    black, _ = env.reset(seed=4)
    shown, _ = env.reset(seed=4, options={"record_screenshots": True})
    env.set_record_screenshots(False)
    assert not black["screenshot"].any()
    assert shown in env.observation_space
    assert shown["screenshot"].shape == (210, 160, 3)
    assert len(np.unique(shown["screenshot"].reshape(-1, 3), axis=0)) > 20
    assert env.render() is None
    assert list(differences({**shown, "screenshot": None}, {**black, "screenshot": None})) == []


def test_a_killed_browser_cuts_the_episode_off_and_the_next_reset_works(env: MiniWoB) -> None:
    observed, _ = env.reset(seed=4)
    kill_browser(env._farm)
    observed, reward, terminated, truncated, info = env.step(press_first(env, observed, right=True))
    assert (reward, terminated, truncated, info["lost"]) == (0.0, False, True, "browser_died")
    observed, info = env.reset(seed=4)
    assert "lost" not in info
    assert env.step(press_first(env, observed, right=True))[1] == 10.0


def test_a_task_that_does_not_exist_starts_no_browser(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("browser_farm.gym.env.ChromeFarm", lambda **_: pytest.fail("started"))
    with pytest.raises(ValueError, match="no MiniWoB task 'click-buton': did you mean 'click-button'"):
        gymnasium.make("giirl/MiniWoB-v0", task="click-buton")
    monkeypatch.setattr("browser_farm.gym.env.ChromeFarm", lambda **_: None)
    unopened = MiniWoB("click-button")
    with pytest.raises(gymnasium.error.ResetNeeded):
        unopened.step(None)


# ---- many places


def random_actions(envs: MiniWoBVector, seed: int) -> Iterator[Any]:
    envs.action_space.seed(seed)
    while True:
        yield envs.action_space.sample()


def test_many_places_give_observations_of_their_batched_space(envs: MiniWoBVector) -> None:
    observed, infos = envs.reset(seed=20)
    assert observed in envs.observation_space
    assert list(infos["seed"]) == [20, 21]
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    for _, actions in zip(range(2 * LIMIT), random_actions(envs, 5), strict=False):
        observed, rewards, terminated, truncated, infos = envs.step(actions)
        assert observed in envs.observation_space
        assert rewards.shape == terminated.shape == truncated.shape == (PLACES,)
        assert (infos["done"] == terminated).all()


def test_each_place_goes_on_as_an_environment_of_its_own_would(envs: MiniWoBVector) -> None:
    """Same seeds, same actions: observations, rewards, ends and the pages that follow."""
    observed, infos = envs.reset(seed=31)
    singles = [MiniWoB(task) for task in TASKS]
    try:
        expected = [each.reset(seed=31 + at) for at, each in enumerate(singles)]
        taken, over = [0] * PLACES, [False] * PLACES
        for actions in [next(random_actions(envs, seed)) for seed in range(3 * LIMIT)]:
            for at, (one, info) in enumerate(expected):
                assert all(infos[key][at] == info[key] for key in ("seed", "raw_reward", "reason"))
                for key in ("utterance", "fields", "dom_elements"):
                    assert list(differences(observed[key][at], one[key])) == []
            ends = []
            for at, each in enumerate(singles):
                if over[at]:
                    expected[at], taken[at], reward, done = each.reset(), 0, 0.0, False
                else:
                    action = {key: values[at] for key, values in actions.items()}
                    one, reward, done, _, info = each.step(action)
                    expected[at], taken[at] = (one, info), taken[at] + 1
                over[at] = done or taken[at] == LIMIT
                ends.append((reward, done, over[at] and not done))
            observed, rewards, terminated, truncated, infos = envs.step(actions)
            assert list(zip(rewards, terminated, truncated, strict=True)) == ends
    finally:
        for each in singles:
            each.close()


def test_a_step_is_one_call_to_each_tab_and_restarting_costs_none(
    envs: MiniWoBVector, monkeypatch: pytest.MonkeyPatch
) -> None:
    observed, _ = envs.reset(seed=20)
    calls: list[int] = []
    evaluate = envs._farm._tabs.ask

    def counting(asked: dict[int, list[Any]], **how: Any) -> Any:
        calls.append(len(asked))
        return evaluate(asked, **how)

    monkeypatch.setattr(envs._farm._tabs, "ask", counting)
    submit = [next((e["ref"] for e in page if e["tag"] == "button"), 0) for page in observed["dom_elements"]]
    _, _, terminated, _, _ = envs.step([{"action_type": 8, "ref": ref} for ref in submit])
    assert terminated.all()
    observed, rewards, terminated, _, infos = envs.step([None] * PLACES)
    assert not terminated.any()
    assert not rewards.any()
    assert calls == [PLACES]
    assert all(len(page) > 3 for page in observed["dom_elements"])
    assert not set(infos["seed"]) & {20, 21}


def test_a_killed_browser_cuts_every_place_off_and_they_restart(envs: MiniWoBVector) -> None:
    envs.reset(seed=20)
    kill_browser(envs._farm)
    _, rewards, terminated, truncated, infos = envs.step([None] * PLACES)
    assert truncated.all()
    assert not terminated.any()
    assert not rewards.any()
    assert list(infos["lost"]) == ["browser_died"] * PLACES
    observed, _, terminated, truncated, _ = envs.step([None] * PLACES)
    assert not (terminated | truncated).any()
    assert all(len(page) > 3 for page in observed["dom_elements"])


def test_what_cannot_be_stepped_is_refused_in_one_line(envs: MiniWoBVector) -> None:
    envs.reset(seed=20)
    with pytest.raises(ValueError, match="got 1 actions, wanted one for each of 2"):
        envs.step([None])
    with pytest.raises(ValueError, match="got 3 seeds, wanted one for each of 2"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="differ in size"):
        MiniWoBVector(["click-test", "flight.AA"])
