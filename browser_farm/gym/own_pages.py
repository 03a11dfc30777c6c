"""Tasks on pages of one's own in the environments: their farm, and their pages in the miniwob package's format."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from browser_farm.chrome.answers import pixels
from browser_farm.gym.elements import Elements
from browser_farm.sites.episode import draw
from browser_farm.sites.farm import SiteFarm
from browser_farm.sites.fields import DRAWN
from browser_farm.sites.page import WIDTH
from browser_farm.sites.task_file import SiteTask, load_task
from giirl_core.config.sections import Sandbox
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult


def size_of(task: SiteTask) -> tuple[int, int]:
    """Width and height of the viewport in the units of its pages: 160 wide, as MiniWoB's."""
    width, height = task.file.viewport
    return round(WIDTH), round(WIDTH * height / width)


def is_rewarded(task: SiteTask) -> bool:
    """Whether the environment has a reward: the task file says what success is, and when an episode is over."""
    return task.measured and bool(task.file.end)


class OwnPagesFarm:
    """What the environments use of a farm, for task files. Its pages are `Elements` with the rows that agents see."""

    def __init__(
        self, tasks: Sequence[str], tabs: int, *, headless: bool, call_timeout_s: float, chrome_sandbox: Sandbox
    ) -> None:
        self._farm = SiteFarm(
            tasks, tabs=tabs, headless=headless, call_timeout_s=call_timeout_s, chrome_sandbox=chrome_sandbox
        )
        self._tasks: dict[int, SiteTask] = {}  # tab -> the task of its episode

    @property
    def unopened(self) -> Mapping[int, str]:
        """Why the pages of tabs did not open in the last call."""
        return self._farm.unopened

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        """Open an episode in each tab."""
        self._tasks |= {tab: load_task(spec.task) for tab, spec in episodes.items()}
        return {tab: _with_elements(observation) for tab, observation in self._farm.reset(episodes).items()}

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        """Act in each tab; the tasks of tabs never change. The reward of a task that has none is 0."""
        results = {}
        for tab, result in self._farm.step(commands).items():
            seen = result.observation
            results[tab] = replace(
                result,
                raw_reward=result.raw_reward if is_rewarded(self._tasks[tab]) else 0.0,
                observation=None if seen is None else _with_elements(seen),
            )
        return results

    def refresh(self, tab: int) -> None:
        """Nothing: every episode opens its page anew."""

    def run_script(self, tab: int, script: str) -> str | None:
        """ValueError: the pages are not the environment's own."""
        raise ValueError("attention is drawn on MiniWoB's pages only, and this task is on a page of one's own")

    def screenshots(self, tabs: Iterable[int], width: int, height: int) -> dict[int, NDArray[np.uint8]]:
        """[height, width, 3] RGB of each tab's upper left corner, taken one by one; black for a tab without picture."""
        return {tab: pixels(self._farm.screenshot(tab, (0, 0, width, height)), width, height) for tab in tabs}

    def close(self) -> None:
        """Close the farm."""
        self._farm.close()


def _with_elements(observation: Observation) -> Observation:
    """The observation with its page as `Elements`. The id of an element is all of `Page.attributes`."""
    page, goal, episode = observation.page, observation.goal.utterance, observation.episode
    drawn = draw(load_task(episode.task), episode.seed).values
    flags = np.stack([page.focused, page.tampered, np.zeros_like(page.focused), page.leaf], axis=1)
    elements = Elements(
        **{name: getattr(page, name) for name in page.__dataclass_fields__},
        utterance=goal,
        fields=tuple((key, value) for key, value in drawn.items() if key not in DRAWN and value in goal),
        id=page.attributes,
        raw_value=page.value,
        flags=flags.astype(np.int8),
        background=("",) * len(page),
        foreground=("",) * len(page),
        agent_page=page,
    )
    return replace(observation, page=elements)
