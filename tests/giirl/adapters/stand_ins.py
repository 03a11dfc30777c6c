"""A farm without a browser that shows one page, and an untrained reward in a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from browser_farm.gym.elements import decode_elements
from giirl import LearnedReward
from giirl_core.config_file import load_config
from giirl_core.nets.parameters import serialise_net
from giirl_core.nets.reward import build_reward, export_reward
from giirl_core.types import Command, EpisodeSpec, Goal, Observation, StepResult

UTTERANCE = 'Enter "Ada" and press Ok.'
BODY, FIELD, OK = 1, 2, 3  # refs
LOST = 7  # seed of an episode that is lost
TABLE: list[Any] = [
    [UTTERANCE, []],
    ["body", "input_text", "button"],
    ["", "", "Ok"],
    [None, "", None],
    ["", "tt", ""],
    ["", "", "wide"],
    [BODY, -1, 0, 0, 0, FIELD, 0, 0, 0, 0, OK, 0, 8, 0, 0],
    [0.0, 0.0, 160.0, 210.0, 2.0, 52.0, 128.0, 21.0, 2.0, 80.0, 40.0, 21.0],
    [""],
]
ROWS: list[Any] = [
    ["input_text", "button"],
    ["", "Ok"],
    ["", ""],
    ["", "wide"],
    [FIELD, -1, 0, OK, -1, 0],
    [2.0, 52.0, 128.0, 21.0, 2.0, 80.0, 40.0, 21.0],
    [0, "", "", "tt"],
]


class Farm:
    """Stands in for Chrome: one page, on which a click on the button ends the episode with the reward 1."""

    def __init__(self) -> None:
        self.unopened: dict[int, str] = {}
        self.seeds: dict[int, int] = {}

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        self.seeds |= {tab: episode.seed for tab, episode in episodes.items()}
        page = decode_elements([*TABLE, ROWS])
        return {tab: Observation(episode=e, page=page, goal=Goal(UTTERANCE)) for tab, e in episodes.items()}

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        results = {}
        for tab, command in commands.items():
            lost = "tab_crashed" if self.seeds[tab] == LOST else ""
            done = command.ref == OK and not lost
            episode = EpisodeSpec(task="", seed=self.seeds[tab])
            following = command.following if done or lost else episode
            opened = self.reset({tab: following}) if following else {}
            results[tab] = StepResult(raw_reward=float(done), done=done, observation=opened.get(tab), lost=lost)
        return results

    def close(self) -> None:
        """Nothing is open."""


def exported_reward(path: Path, *settings: str) -> LearnedReward:
    """The reward of untrained nets with these settings, as version 3."""
    config = load_config(None, ["net.vectors=hashed", *settings])
    export_reward(config, serialise_net(build_reward(config).net, 3), path)
    return LearnedReward(path)
