"""Compares our environment with the miniwob package's: same seeds, same actions, every field of every observation.

Only some tasks; `python -m benchmarks.gym_equality` compares all of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from miniwob.action import ActionSpaceConfig

from benchmarks.gym_equality import ELEMENT_ACTIONS, Comparison, PackageEnv, compare_task, switch_task
from browser_farm.gym.env import MiniWoB

pytestmark = [pytest.mark.chrome, pytest.mark.slow]

TASKS = [
    "click-button",
    "click-dialog-2",  # the focused element has a style of its own
    "click-pie-nodelay",  # SVG that is drawn in the first animation frames
    "choose-list",
    "email-inbox-nl-turk",  # the page itself returns the fields
    "enter-text",
    "text-transform",  # lines of bare text
    "use-slider",
]


@pytest.fixture(scope="module")
def reference() -> Iterator[PackageEnv]:
    made = PackageEnv()
    yield made
    made.env.close()


@pytest.fixture(scope="module")
def ours() -> Iterator[MiniWoB]:
    made = MiniWoB("click-test")
    yield made
    made.close()


def test_the_spaces_are_those_of_the_package(reference: PackageEnv, ours: MiniWoB) -> None:
    assert ours.observation_space == reference.env.observation_space
    for preset in ("all_supported", "shi17", "liu18", "humphreys22"):
        config = ActionSpaceConfig.get_preset(preset)
        config.screen_width, config.screen_height = 160, 210
        ours.adapter = type(ours.adapter).of("click-test", preset)
        assert ours.adapter.action_space == config.get_action_space()
    assert ours.action_space == reference.env.action_space


@pytest.mark.parametrize("task", TASKS)
def test_every_field_is_equal_after_every_action(reference: PackageEnv, ours: MiniWoB, task: str) -> None:
    comparison = Comparison()
    compare_task(
        task, reference, switch_task(ours, task), comparison, kinds=ELEMENT_ACTIONS, seeds=range(70, 72), steps=3
    )
    assert comparison.differences == []
    assert comparison.observations >= 4


@pytest.mark.parametrize("task", ["click-button", "email-inbox", "count-shape"])
def test_screenshots_are_equal_pixel_by_pixel(reference: PackageEnv, ours: MiniWoB, task: str) -> None:
    options = {"record_screenshots": True}
    theirs, _ = reference.switch_task(task).reset(seed=71, options=options)
    shown, _ = switch_task(ours, task).reset(seed=71, options=options)
    ours.set_record_screenshots(False)
    assert np.array_equal(shown["screenshot"], theirs["screenshot"])
