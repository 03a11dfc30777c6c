"""The Gymnasium environment passes Gymnasium's checker and follows the tables of the world."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import gridcraft  # noqa: F401 - registers the environment
from gridcraft.env import LanguageGridCraft
from gridcraft.instructions import ColourPair, ordered_pairs, sentences
from gridcraft.layouts import random_layout
from gridcraft.world import HORIZON, true_reward


@pytest.mark.parametrize(
    "layout",
    ["regions", "four", "corridor", random_layout(1, height=5, width=9)],
    ids=["open", "four", "walls", "random"],
)
def test_gymnasium_accepts_the_environment(layout: Any) -> None:
    check_env(gymnasium.make("giirl/LanguageGridCraft-v0", layout=layout, slip=0.1, render_mode="ansi").unwrapped)


def test_gymnasium_makes_the_environment_by_its_registered_name() -> None:
    env = gymnasium.make("giirl/LanguageGridCraft-v0", layout="four", plain=True)
    observation, info = env.reset(seed=0)
    assert isinstance(env.unwrapped, LanguageGridCraft)
    assert observation["instruction"] == f"Go to {info['goal'].capitalize()}. Avoid {info['avoid'].capitalize()}."


def test_the_observation_space_contains_every_sentence() -> None:
    space = LanguageGridCraft("four").observation_space["instruction"]  # type: ignore[index]
    assert all(space.contains(sentence) for pair in ordered_pairs() for sentence in sentences(pair))


def test_rewards_and_transitions_follow_the_tables_and_episodes_end_only_at_the_horizon() -> None:
    env = LanguageGridCraft("regions")
    pair = ColourPair("blue", "green")
    _, info = env.reset(seed=3, options={"pair": pair})
    assert (info["goal"], info["avoid"]) == ("blue", "green")
    reward, rng = true_reward(env.world, pair), np.random.default_rng(0)
    for t in range(HORIZON):
        state, action = info["state"], int(rng.integers(5))
        observation, got, terminated, truncated, info = env.step(action)
        assert got == reward[state, action]
        assert info["state"] == env.world.next_state[state, action]
        assert (observation["position"] == env.world.position[info["state"]]).all()
        assert (terminated, truncated) == (False, t == HORIZON - 1)


def test_the_seed_determines_the_instruction_and_the_start_state() -> None:
    env = LanguageGridCraft("regions")
    first = [(o["instruction"], i["state"]) for o, i in (env.reset(seed=s) for s in range(30))]
    assert first == [(o["instruction"], i["state"]) for o, i in (env.reset(seed=s) for s in range(30))]
    assert len(set(first)) > 20


def test_episodes_use_only_the_allowed_pairs() -> None:
    allowed = (ColourPair("red", "blue"), ColourPair("green", "blue"))
    env = LanguageGridCraft("regions", pairs=allowed)
    used = {ColourPair(i["goal"], i["avoid"]) for _, i in (env.reset(seed=s) for s in range(30))}
    assert used == set(allowed)
    with pytest.raises(ValueError, match=r"wanted .'pair'"):
        env.reset(options={"pair": ColourPair("blue", "red")})
    with pytest.raises(ValueError, match=r"wanted .'pair'"):
        env.reset(options={"layout": "four"})


def test_the_rendering_shows_the_instruction_and_the_agent_on_the_map() -> None:
    env = LanguageGridCraft("regions", render_mode="ansi")
    observation, _ = env.reset(seed=1)
    lines = str(env.render()).splitlines()
    row, column = observation["position"]
    assert lines[0] == observation["instruction"]
    assert lines[1 + row][column] == "@"
    assert lines[1][0] in "R@"


def test_illegal_arguments_are_errors_that_name_the_legal_ones() -> None:
    with pytest.raises(ValueError, match="wanted 'ansi'"):
        LanguageGridCraft(render_mode="human")
    with pytest.raises(ValueError, match="at least 1"):
        LanguageGridCraft(horizon=0)
    env = LanguageGridCraft()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="wanted 0 to 4"):
        env.step(5)
