"""Clicks on containers: one test per rule that finds the leaf, and every rule documents an example."""

from __future__ import annotations

from pathlib import Path

import pytest

from browser_farm.human.action_inference import KEY_RULES, MOUSE_RULES
from browser_farm.human.leaf_rules import LEAF_RULES
from tests.browser_farm.human.recording_builder import (
    Dom,
    RecordingBuilder,
    actions_of,
    bare_text,
    body,
    element,
    skip_reason,
    trajectory_of,
)

AREA = 3  # ref of the element that holds the page


def leaf_of(recording: RecordingBuilder, tmp_path: Path, raw_reward: float = 1) -> tuple[str, str]:
    """Tag and text of the element of the last action."""
    trajectory = trajectory_of(recording, tmp_path, raw_reward)
    row = trajectory.actions[-1].element
    return trajectory.pages[-1].tag[row], trajectory.pages[-1].text[row]


def clicked(ref: int, at: tuple[float, float], *content: Dom) -> RecordingBuilder:
    """A recording whose only action is the click that ends the episode."""
    recording = RecordingBuilder(body(*content), "Click it.")
    recording.click(ref, at)
    return recording


def checkbox(ref: int, top: float) -> Dom:
    return element("INPUT_checkbox", ref, value=False, text="", box=(5, top, 13, 13))


def test_the_checkbox_that_changed_is_clicked(tmp_path: Path) -> None:
    group = element("DIV", 4, checkbox(5, 50), checkbox(6, 70), bare_text("bees", (30, 50, 60, 20)))
    recording = RecordingBuilder(body(group, element("BUTTON", 7, text="Submit")), "Select bees.")
    recording.click(4, (100, 55), effect=lambda: recording.flip(6))
    recording.click(7)
    assert actions_of(trajectory_of(recording, tmp_path)) == [("CLICK", 6, ""), ("CLICK", 7, "")]


def test_the_only_checkbox_is_clicked_if_the_episode_ends_before_it_changes(tmp_path: Path) -> None:
    recording = clicked(4, (40, 55), element("DIV", 4, checkbox(5, 50), bare_text("bees", (30, 50, 60, 20))))
    assert leaf_of(recording, tmp_path) == ("input_checkbox", "")


def test_the_only_leaf_is_clicked_wherever_the_mouse_is(tmp_path: Path) -> None:
    recording = clicked(4, (150, 65), element("H3", 4, bare_text("Section", (5, 50, 30, 10))))
    assert leaf_of(recording, tmp_path) == ("t", "Section")


def test_of_the_leaves_under_the_mouse_the_smallest_is_clicked(tmp_path: Path) -> None:
    large = bare_text("large", (0, 50, 100, 20))
    small = element("I", 5, text="small", box=(20, 50, 10, 10))
    assert leaf_of(clicked(4, (25, 55), element("DIV", 4, large, small)), tmp_path) == ("i", "small")


def test_the_leaf_of_a_control_that_is_nearest_to_the_mouse_is_clicked(tmp_path: Path) -> None:
    icon = element("DIV", 5, classes="icon", box=(90, 50, 18, 18))
    text = element("DIV", 6, text="Forward", box=(80, 70, 40, 9))
    assert leaf_of(clicked(4, (82, 67), element("SPAN", 4, icon, text)), tmp_path) == ("div", "Forward")


def test_a_click_between_the_leaves_of_a_container_is_skipped_but_kept_in_a_failure(tmp_path: Path) -> None:
    leaves = [element("BUTTON", ref, text=str(ref), box=(0, 50, 10, 10)) for ref in (5, 6)]
    recording = clicked(AREA, (150, 200), *leaves)
    assert skip_reason(recording, tmp_path) == "click on a container"
    assert leaf_of(recording, tmp_path, raw_reward=-1) == ("div", "")


def test_a_last_click_outside_the_task_is_skipped(tmp_path: Path) -> None:
    recording = RecordingBuilder(body(element("BUTTON", 5, text="ok")), "Click it.")
    recording.click(1, (700, 5))
    assert skip_reason(recording, tmp_path) == "click outside the task"


@pytest.mark.parametrize("rule", [*KEY_RULES, *MOUSE_RULES, *LEAF_RULES], ids=lambda rule: rule.__name__)
def test_the_docstring_of_every_rule_gives_an_example(rule: object) -> None:
    assert "    Example" in str(rule.__doc__)
