"""The Gymnasium environment: Gymnasium's own check, and the same world that the tables describe."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import gridcraft  # noqa: F401 - registers the environment
from gridcraft.env import LanguageGridCraft
from gridcraft.instructions import Pair, ordered_pairs, sentences
from gridcraft.layouts import random_layout
from gridcraft.world import HORIZON, true_reward


@pytest.mark.parametrize(
    "layout",
    ["regions", "four", "corridor", random_layout(1, height=5, width=9)],
    ids=["open", "four", "walls", "random"],
)
def test_gymnasium_accepts_the_environment(layout: Any) -> None:
    check_env(gymnasium.make("giirl/LanguageGridCraft-v0", layout=layout, slip=0.1, render_mode="ansi").unwrapped)


def test_the_registered_name_makes_it() -> None:
    env = gymnasium.make("giirl/LanguageGridCraft-v0", layout="four", plain=True)
    seen, info = env.reset(seed=0)
    assert isinstance(env.unwrapped, LanguageGridCraft)
    assert seen["instruction"] == f"Go to {info['goal'].capitalize()}. Avoid {info['avoid'].capitalize()}."


def test_every_sentence_fits_the_space_it_is_announced_in() -> None:
    space = LanguageGridCraft("four").observation_space["instruction"]  # type: ignore[index]
    assert all(space.contains(sentence) for pair in ordered_pairs() for sentence in sentences(pair))


def test_an_episode_pays_by_the_tables_and_ends_at_the_horizon_alone() -> None:
    env = LanguageGridCraft("regions")
    pair = Pair("blue", "green")
    _, info = env.reset(seed=3, options={"pair": pair})
    assert (info["goal"], info["avoid"]) == ("blue", "green")
    reward, rng = true_reward(env.world, pair), np.random.default_rng(0)
    for t in range(HORIZON):
        state, action = info["state"], int(rng.integers(5))
        seen, earned, terminated, truncated, info = env.step(action)
        assert earned == reward[state, action]
        assert info["state"] == env.world.next_state[state, action]
        assert (seen["position"] == env.world.position[info["state"]]).all()
        assert (terminated, truncated) == (False, t == HORIZON - 1)


def test_the_seed_fixes_what_is_asked_and_where_it_starts() -> None:
    env = LanguageGridCraft("regions")
    first = [(o["instruction"], i["state"]) for o, i in (env.reset(seed=s) for s in range(30))]
    assert first == [(o["instruction"], i["state"]) for o, i in (env.reset(seed=s) for s in range(30))]
    assert len(set(first)) > 20


def test_only_the_pairs_allowed_are_asked_for() -> None:
    allowed = (Pair("red", "blue"), Pair("green", "blue"))
    env = LanguageGridCraft("regions", pairs=allowed)
    asked = {Pair(i["goal"], i["avoid"]) for _, i in (env.reset(seed=s) for s in range(30))}
    assert asked == set(allowed)
    with pytest.raises(ValueError, match=r"wanted .'pair'"):
        env.reset(options={"pair": Pair("blue", "red")})
    with pytest.raises(ValueError, match=r"wanted .'pair'"):
        env.reset(options={"layout": "four"})


def test_the_picture_shows_the_agent_on_the_map_under_its_instruction() -> None:
    env = LanguageGridCraft("regions", render_mode="ansi")
    seen, _ = env.reset(seed=1)
    picture = str(env.render()).splitlines()
    row, column = seen["position"]
    assert picture[0] == seen["instruction"]
    assert picture[1 + row][column] == "@"
    assert picture[1][0] in "R@"


def test_what_the_environment_cannot_do_is_refused_with_what_it_can() -> None:
    with pytest.raises(ValueError, match="wanted 'ansi'"):
        LanguageGridCraft(render_mode="human")
    with pytest.raises(ValueError, match="at least 1"):
        LanguageGridCraft(horizon=0)
    env = LanguageGridCraft()
    env.reset(seed=0)
    with pytest.raises(ValueError, match="wanted 0 to 4"):
        env.step(5)
