"""Task files in the Gymnasium environments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import browser_farm  # noqa: F401 (registers the environment)
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector
from giirl_core.types import Action, Verb
from tests.browser_farm.sites.guests import EXPERT, PAGE, SUCCESS, TASK


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a page and two task files for it."""
    (tmp_path / "guests.html").write_text(PAGE)
    (tmp_path / "experts.py").write_text(EXPERT)
    (tmp_path / "guests.toml").write_text(TASK + SUCCESS)
    (tmp_path / "unmeasured.toml").write_text(TASK)
    return tmp_path


def ref_of(observation: dict[str, Any], tag: str, text: str) -> int:
    """The ref of the element with this tag and text."""
    elements = observation["dom_elements"]
    return next(int(e["ref"]) for e in elements if (e["tag"], e["text"]) == (tag, text))


def add(env: MiniWoB, observation: dict[str, Any], name: str) -> tuple[dict[str, Any], float, bool, dict[str, Any]]:
    """Type a name and press Add; the end of the episode."""
    field = ref_of(observation, "input_text", "Name")
    action = env.create_action("FOCUS_ELEMENT_AND_TYPE_TEXT", ref=field, text=name)
    observation, reward, terminated, truncated, info = env.step(action)
    assert (reward, terminated, truncated) == (0.0, False, False), info
    button = ref_of(observation, "button", "Add")
    observation, reward, terminated, _, info = env.step(env.create_action("CLICK_ELEMENT", ref=button))
    return observation, reward, terminated, info


@pytest.mark.chrome
def test_a_task_file_is_played_in_the_package_s_format(folder: Path) -> None:
    made = gymnasium.make("giirl/MiniWoB-v0", task=str(folder / "guests.toml"), agent_page=True)
    env: Any = made.unwrapped
    try:
        observation, info = env.reset(seed=3)
        page, goal = info["page"], info["goal"]
        assert goal.utterance == observation["utterance"]
        [(key, name)] = observation["fields"]
        assert (key, observation["utterance"]) == ("name", f'Add the guest "{name}".')
        assert env.observation_space.contains(observation)
        assert (info["measured"], info["seed"]) == (True, 3)
        assert {"body", "h1", "button"} <= {element.tag for element in info["root_dom"].subtree_elements}
        _, reward, terminated, info = add(env, observation, name)
        assert (reward, terminated, info["raw_reward"]) == (1.0, True, 1.0)
        assert info["action"] == Action(verb=Verb.CLICK, element=page.tag.index("button"))
        observation, _ = env.reset(seed=3)
        assert dict(observation["fields"]) == {"name": name}
        _, reward, terminated, _ = add(env, observation, "Nobody")
        assert (reward, terminated) == (-1.0, True)
        env.reset(seed=4, options={"record_screenshots": True})
        picture = env.step(None)[0]["screenshot"]
        assert picture.shape == (100, 160, 3)
        assert picture.any()
        with pytest.raises(ValueError, match="attention is drawn on MiniWoB's pages only"):
            env.visualize_attention([[1.0]])
    finally:
        made.close()


@pytest.mark.chrome
@pytest.mark.filterwarnings("ignore:.*Box action spaces")  # the package's own coordinates are pixels
def test_a_task_file_without_success_has_no_reward_and_info_says_so(folder: Path) -> None:
    made = gymnasium.make("giirl/MiniWoB-v0", task=str(folder / "unmeasured.toml"))
    env: Any = made.unwrapped
    try:
        observation, info = env.reset(seed=3)
        assert info["measured"] is False
        _, reward, terminated, info = add(env, observation, dict(observation["fields"])["name"])
        assert (reward, terminated, info["raw_reward"], info["measured"]) == (0.0, True, 0.0, False)
        check_env(env, skip_render_check=True)
    finally:
        made.close()


@pytest.mark.chrome
def test_task_files_are_played_side_by_side(folder: Path) -> None:
    tasks = [str(folder / "guests.toml"), str(folder / "unmeasured.toml")]
    envs: Any = gymnasium.make_vec("giirl/MiniWoB-v0", num_envs=2, task=tasks, max_episode_steps=2).unwrapped
    try:
        observation, infos = envs.reset(seed=[1, 2])
        assert infos["measured"].tolist() == [True, False]
        refs = [next(e["ref"] for e in page if e["text"] == "Add") for page in observation["dom_elements"]]
        actions = [
            envs._slots[0].adapter.create_action(envs.single_action_space, "CLICK_ELEMENT", {"ref": int(ref)})
            for ref in refs
        ]
        _, rewards, terminated, truncated, _ = envs.step(actions)
        assert (rewards.tolist(), terminated.tolist()) == ([-1.0, 0.0], [True, True])
        assert not truncated.any()
        observation, rewards, terminated, _, infos = envs.step(actions)
        assert not rewards.any()
        assert not terminated.any()
        assert all(observation["utterance"])
        assert np.unique(infos["seed"]).size == 2
    finally:
        envs.close()


@pytest.mark.parametrize(
    ("message", "arguments"),
    [
        ("cannot read the task file .*none.toml", {"task": "none.toml"}),
        ("base_url and wait_ms are for MiniWoB's pages", {"task": "guests.toml", "wait_ms": 5}),
        ("base_url and wait_ms are for MiniWoB's pages", {"task": "guests.toml", "base_url": "http://127.0.0.1:1/"}),
    ],
)
def test_a_wrong_argument_is_one_clear_line_before_a_browser_starts(
    message: str, arguments: dict[str, Any], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("browser_farm.gym.launch.OwnPagesFarm", lambda *_, **__: pytest.fail("started"))
    with pytest.raises(ValueError, match=message):
        MiniWoB(**{**arguments, "task": str(folder / arguments["task"])})


def test_tasks_of_both_kinds_are_not_played_together(folder: Path) -> None:
    (folder / "guests.toml").write_text((TASK + SUCCESS).replace("[640, 400]", "[160, 210]"))
    with pytest.raises(ValueError, match="wanted task files only, or MiniWoB's tasks only"):
        MiniWoBVector(["click-test", str(folder / "guests.toml")])
