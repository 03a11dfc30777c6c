"""The example with Stable-Baselines3: slots of a page as a discrete environment, and PPO on the learned reward."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env

from browser_farm.gym.env import MiniWoB
from examples.stable_baselines3.policy import SlotPolicy
from examples.stable_baselines3.slots import FEATURES, SLOTS, ElementSlots
from giirl import LearnedRewardWrapper
from tests.giirl.adapters.stand_ins import Farm, exported_reward


@pytest.fixture
def env(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> ElementSlots:
    """The slots of a page with a field and the button Ok, on an untrained reward."""
    monkeypatch.setattr("browser_farm.gym.env.open_farm", lambda *_, **__: Farm())
    bare = MiniWoB("click-test", agent_page=True, root_dom=False)
    return ElementSlots(LearnedRewardWrapper(bare, exported_reward(tmp_path / "reward")))


def test_a_slot_is_an_element_and_its_number_clicks_it(env: ElementSlots) -> None:
    observation, info = env.reset(seed=1)
    slots = observation.reshape(SLOTS, len(FEATURES))
    named = dict(zip(FEATURES, slots[:3].T.tolist(), strict=True))
    assert named["is there"] == [1, 1, 0]
    assert named["field"] == [1, 0, 0]
    assert named["button"] == named["named in the goal"] == named["words in the goal"] == [0, 1, 0]
    assert {"page", "goal"} & set(info) == set()
    _, waiting, terminated, _, _ = env.step(SLOTS - 1)
    assert (waiting, terminated) == (-5.0, False)
    _, reward, terminated, _, info = env.step(1)
    assert (terminated, info["true_reward"], info["raw_reward"]) == (True, 1.0, 1.0)
    assert reward not in (1.0, -5.0)


def test_stable_baselines3_accepts_the_environment_and_its_policy_never_chooses_an_empty_slot(
    env: ElementSlots,
) -> None:
    check_env(env)
    model = PPO(SlotPolicy, env, n_steps=32, batch_size=16, n_epochs=1, device="cpu")
    model.learn(32)
    observation, _ = env.reset(seed=1)
    net: Any = model.policy.get_distribution(torch.from_numpy(observation[None])).distribution
    chances = net.probs[0].detach().numpy()
    assert chances[2:].tolist() == [0.0] * (SLOTS - 2)
    assert np.all(chances[:2] > 0.01)
