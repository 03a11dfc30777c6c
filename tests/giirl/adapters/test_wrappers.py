"""The wrappers that put the learned reward in the place of an environment's own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import browser_farm  # noqa: F401 (registers the environment)
from browser_farm.farm import ChromeFarm
from browser_farm.gym.elements import decode_elements
from browser_farm.gym.env import MiniWoB
from browser_farm.gym.vector_env import MiniWoBVector
from giirl import LearnedReward, LearnedRewardVectorWrapper, LearnedRewardWrapper
from giirl_core.types import Action, EpisodeSpec, Page, Verb
from tests.giirl.adapters.stand_ins import FIELD, LOST, OK, ROWS, TABLE, UTTERANCE, Farm, exported_reward

TASKS = ["click-button", "enter-text", "choose-list", "click-dialog", "click-link", "click-shape", "email-inbox"]


@pytest.fixture(scope="module")
def reward(tmp_path_factory: pytest.TempPathFactory) -> LearnedReward:
    """An untrained reward."""
    return exported_reward(tmp_path_factory.mktemp("reward") / "reward.safetensors")


@pytest.fixture
def farm(monkeypatch: pytest.MonkeyPatch) -> Farm:
    made = Farm()
    for module in ("env", "vector_env"):
        monkeypatch.setattr(f"browser_farm.gym.{module}.open_farm", lambda *_, **__: made)
    return made


def of_rows(reward: LearnedReward, *actions: Action) -> Any:
    """The rewards of actions on the page as agents read it."""
    page = decode_elements([*TABLE, ROWS]).agent_page
    assert page is not None
    return pytest.approx(reward.score_actions(page, actions, UTTERANCE).tolist(), abs=1e-5)


CLICK = Action(verb=Verb.CLICK, element=1)
TYPE = Action(verb=Verb.TYPE, element=0, start=2, end=2)


def test_the_reward_of_a_step_is_the_learned_one_and_the_true_one_is_in_info(farm: Farm, reward: LearnedReward) -> None:
    env = LearnedRewardWrapper(MiniWoB("click-test", agent_page=True), reward)
    bare: Any = env.unwrapped
    _, info = env.reset(seed=1)
    assert "true_reward" not in info
    _, typed, terminated, _, info = env.step(bare.create_action("FOCUS_ELEMENT_AND_TYPE_TEXT", ref=FIELD, text="Ada"))
    assert (terminated, info["true_reward"], info["action"]) == (False, 0.0, TYPE)
    _, clicked, terminated, _, info = env.step(bare.create_action("CLICK_ELEMENT", ref=OK))
    assert (terminated, info["true_reward"], info["action"]) == (True, 1.0, CLICK)
    assert [typed, clicked] == of_rows(reward, TYPE, CLICK)
    assert len({typed, clicked, 0.0, 1.0}) == 4
    assert env.step(bare.create_action("CLICK_ELEMENT", ref=OK))[1] == 0.0


def test_a_lost_episode_stays_truncated_and_gets_no_reward(farm: Farm, reward: LearnedReward) -> None:
    env = LearnedRewardWrapper(MiniWoB("click-test", agent_page=True), reward, unknown=-9.0)
    bare: Any = env.unwrapped
    env.reset(seed=LOST)
    _, learned, terminated, truncated, info = env.step(bare.create_action("CLICK_ELEMENT", ref=OK))
    assert (learned, terminated, truncated, info["lost"]) == (0.0, False, True, "tab_crashed")


def test_an_action_that_the_nets_do_not_know_has_the_least_reward_or_the_one_given(
    farm: Farm, reward: LearnedReward, tmp_path: Path
) -> None:
    rewards = {
        "logit": (reward, -5.0),
        "log_d": (exported_reward(tmp_path / "d", "discriminator.reward=log_d"), -5.0067),
    }
    for learned, least in rewards.values():
        env = LearnedRewardWrapper(MiniWoB("click-test", agent_page=True), learned)
        env.reset(seed=1)
        _, got, _, _, info = env.step(None)
        assert got == pytest.approx(least, abs=1e-3)
        assert info["action"] is None
    env = LearnedRewardWrapper(MiniWoB("click-test", agent_page=True), reward, unknown=0.25)
    env.reset(seed=1)
    assert env.step(None)[1] == 0.25


def test_a_reward_that_judges_goal_states_is_given_at_the_end_alone(farm: Farm, tmp_path: Path) -> None:
    reward = exported_reward(tmp_path / "goal", "discriminator.reward=goal")
    reward.model.net.eval()
    env = LearnedRewardWrapper(MiniWoB("click-test", agent_page=True), reward, unknown=1.0)
    bare: Any = env.unwrapped
    env.reset(seed=1)
    assert env.step(None)[1] == 0.0
    _, got, terminated, _, _ = env.step(bare.create_action("CLICK_ELEMENT", ref=OK))
    assert terminated
    assert [got] == of_rows(reward, CLICK)


def test_an_environment_that_does_not_show_what_the_reward_reads_is_refused(farm: Farm, reward: LearnedReward) -> None:
    for env in (
        LearnedRewardWrapper(MiniWoB("click-test"), reward),
        LearnedRewardVectorWrapper(MiniWoBVector("click-test", 2), reward),
    ):
        with pytest.raises(ValueError, match=r"wanted gymnasium\.make.*agent_page=True"):
            env.reset(seed=1)


def test_a_vector_has_the_rewards_of_its_environments(farm: Farm, reward: LearnedReward) -> None:
    envs = LearnedRewardVectorWrapper(MiniWoBVector("click-test", 3, agent_page=True), reward)
    bare: Any = envs.unwrapped
    one = bare._slots[0].adapter

    def click(ref: int) -> Any:
        return one.create_action(bare.single_action_space, "CLICK_ELEMENT", {"ref": ref})

    envs.reset(seed=[1, 2, LOST])
    first, second = (
        click(OK),
        one.create_action(bare.single_action_space, "FOCUS_ELEMENT_AND_TYPE_TEXT", {"ref": FIELD, "text": "Ada"}),
    )
    _, rewards, terminated, truncated, infos = envs.step([first, second, click(OK)])
    assert [*rewards[:2]] == of_rows(reward, CLICK, TYPE)
    assert (rewards[2], infos["lost"][2]) == (0.0, "tab_crashed")
    assert (terminated.tolist(), truncated.tolist()) == ([True, False, False], [False, False, True])
    assert infos["true_reward"].tolist() == [1.0, 0.0, 0.0]
    _, rewards, terminated, _, infos = envs.step(
        [click(OK), click(OK), click(OK)]
    )  # begins the first and the third anew
    assert rewards[[0, 2]].tolist() == [0.0, 0.0]
    assert [rewards[1]] == of_rows(reward, CLICK)
    assert infos["true_reward"].tolist() == [0.0, 1.0, 0.0]
    _, rewards, _, _, _ = envs.step([click(OK), click(OK), None])
    assert [rewards[0]] == of_rows(reward, CLICK)
    assert rewards[1:].tolist() == [0.0, pytest.approx(-5.0)]


# ---- a real Chrome


@pytest.fixture(scope="module")
def env(reward: LearnedReward) -> Iterator[LearnedRewardWrapper]:
    made = gymnasium.make("giirl/MiniWoB-v0", task="click-button", agent_page=True, root_dom=False)
    yield LearnedRewardWrapper(made, reward)
    made.close()


@pytest.mark.chrome
@pytest.mark.filterwarnings("ignore:.*Box action spaces")  # the package's own coordinates are pixels
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")  # it is a wrapper
def test_gymnasium_accepts_the_wrapped_environment(env: LearnedRewardWrapper) -> None:
    check_env(env, skip_render_check=True, skip_close_check=True)


@pytest.mark.chrome
def test_the_reward_reads_the_page_that_agents_read() -> None:
    envs: Any = gymnasium.make_vec("giirl/MiniWoB-v0", num_envs=len(TASKS), task=TASKS, agent_page=True)
    farm = ChromeFarm(tabs=len(TASKS))
    try:
        for seed in (3, 4):
            _, infos = envs.reset(seed=[seed] * len(TASKS))
            seen = farm.reset({tab: EpisodeSpec(task=task, seed=seed) for tab, task in enumerate(TASKS)})
            for tab, task in enumerate(TASKS):
                page, wanted = infos["page"][tab], seen[tab].page
                assert without_refs(page) == without_refs(wanted), task
                assert infos["goal"][tab] == seen[tab].goal
                elements = dict(zip(refs(envs._slots[tab].page), envs._slots[tab].page.tag, strict=True))
                assert [elements[ref] for ref in refs(page) if ref] == [
                    tag for ref, tag in zip(refs(page), page.tag, strict=True) if ref
                ]
    finally:
        envs.close()
        farm.close()


def without_refs(page: Page) -> dict[str, Any]:
    """The columns of a page as lists, but for the browser's handles."""
    columns = {name: getattr(page, name) for name in Page.__dataclass_fields__ if name != "ref"}
    return {name: value.tolist() if isinstance(value, np.ndarray) else list(value) for name, value in columns.items()}


def refs(page: Page) -> Sequence[int]:
    found: list[int] = page.ref.tolist()
    return found
