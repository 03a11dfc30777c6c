"""Inferring a person's actions from a recording, one test per rule; and the recordings that are skipped."""

from __future__ import annotations

import zlib
from pathlib import Path

import pytest

from browser_farm.human.recordings import read_recording
from giirl_core.types import DEMONSTRATION, Verb
from tests.browser_farm.human.recording_builder import (
    CONTROL,
    ENTER,
    TAB,
    RecordingBuilder,
    actions_of,
    bare_text,
    body,
    element,
    enter_text_page,
    enter_text_recording,
    skip_reason,
    trajectory_of,
)


def checkboxes() -> RecordingBuilder:
    box = element("INPUT_checkbox", 5, value=False, text="", box=(5, 50, 13, 13))
    label = element("LABEL", 4, box, bare_text("bees"), box=(5, 50, 90, 20))
    other = element("INPUT_checkbox", 8, value=False, text="", box=(5, 75, 13, 13))
    page = body(label, other, element("BUTTON", 6, text="Submit", box=(20, 100, 90, 30)))
    return RecordingBuilder(page, "Select bees and click Submit.")


# ---- rules that give an action, or ignore a gesture


def test_a_click_is_one_action_on_the_page_before_mousedown(tmp_path: Path) -> None:
    recording = RecordingBuilder(
        body(element("BUTTON", 4, text="yes"), element("BUTTON", 5, text="no")), 'Click on "no".'
    )
    recording.click(5, effect=lambda: recording.node(5).update(text="gone"))
    trajectory = trajectory_of(recording, tmp_path)
    assert actions_of(trajectory) == [("CLICK", 5, "")]
    assert trajectory.pages[0].text == ("", "yes", "no")
    assert not trajectory.pages[0].focused.any()


def test_a_click_that_focuses_a_field_is_part_of_the_typing(tmp_path: Path) -> None:
    trajectory = trajectory_of(enter_text_recording("Ada"), tmp_path)
    assert actions_of(trajectory) == [("TYPE", 5, "Ada"), ("CLICK", 6, "")]
    before, after = trajectory.pages
    assert before.value[2] == ""
    assert not before.focused.any()
    assert not before.tampered.any()
    assert after.value[2] == "Ada"
    assert after.focused.tolist() == after.tampered.tolist() == [False, False, True, False]


def test_a_demonstration_has_zero_rewards_and_a_seed_from_its_file_name(tmp_path: Path) -> None:
    trajectory = trajectory_of(enter_text_recording(), tmp_path)
    assert trajectory.policy_version == DEMONSTRATION
    assert trajectory.task == "some-task"
    assert trajectory.seed == zlib.crc32(b"some-task_A_d1")
    assert not trajectory.behaviour_logp.any()
    assert not trajectory.rewards.any()


def test_continued_typing_in_the_same_field_is_one_action_with_the_final_text(tmp_path: Path) -> None:
    recording = RecordingBuilder(enter_text_page(), "Enter Ada Lovelace, then press Submit.")
    recording.click(5)
    recording.type(5, "Ada")
    recording.click(5)
    recording.type(5, " Lovelace")
    recording.click(6)
    assert actions_of(trajectory_of(recording, tmp_path)) == [("TYPE", 5, "Ada Lovelace"), ("CLICK", 6, "")]


def test_tab_and_copying_are_ignored(tmp_path: Path) -> None:
    fields = [element("INPUT_password", ref, value="", text="") for ref in (4, 5)]
    recording = RecordingBuilder(body(*fields, element("BUTTON", 6, text="Submit")), 'Enter "pass" twice.')
    recording.click(4)
    recording.type(4, "pass")
    recording.key(4, CONTROL)
    recording.key(4, ord("C"))
    recording.key(4, TAB)
    recording.focus(5)
    recording.type(5, "pass")
    recording.click(6)
    trajectory = trajectory_of(recording, tmp_path)
    assert actions_of(trajectory) == [("TYPE", 4, "pass"), ("TYPE", 5, "pass"), ("CLICK", 6, "")]
    assert trajectory.pages[1].focused.tolist() == [False, True, False, False]  # as before the Tab key


@pytest.mark.parametrize("with_keys", [True, False])
def test_a_pasted_text_counts_as_typed(tmp_path: Path, with_keys: bool) -> None:
    recording = RecordingBuilder(enter_text_page(), 'Enter "Ada" and press Submit.')
    recording.click(5)
    if with_keys:
        recording.key(5, CONTROL)
        recording.key(5, ord("V"))
    recording.node(5)["value"] = "Ada"
    recording.click(6)
    assert actions_of(trajectory_of(recording, tmp_path)) == [("TYPE", 5, "Ada"), ("CLICK", 6, "")]


def test_enter_on_a_button_is_a_click_on_it(tmp_path: Path) -> None:
    recording = RecordingBuilder(enter_text_page(), 'Enter "Ada" and press Submit.')
    recording.click(5)
    recording.type(5, "Ada")
    recording.key(5, TAB)
    recording.focus(6)
    recording.key(6, ENTER)
    recording.mouse("click", 6, (0, 0))
    assert actions_of(trajectory_of(recording, tmp_path)) == [("TYPE", 5, "Ada"), ("CLICK", 6, "")]


@pytest.mark.parametrize("second_click_event", [True, False])
def test_a_click_on_a_label_is_a_click_on_its_checkbox(tmp_path: Path, second_click_event: bool) -> None:
    recording = checkboxes()
    recording.click(4, (20, 55))
    recording.flip(5)
    if second_click_event:
        recording.mouse("click", 5, (0, 0))
    recording.click(6)
    trajectory = trajectory_of(recording, tmp_path)
    assert actions_of(trajectory) == [("CLICK", 5, ""), ("CLICK", 6, "")]
    assert trajectory.pages[0].value[2] == ""


def test_a_click_on_a_container_is_a_click_on_the_leaf_under_the_mouse(tmp_path: Path) -> None:
    cell = element("DIV", 4, bare_text("one", (0, 50, 20, 10)), bare_text("two", (0, 60, 20, 10)), element("I", 5))
    recording = RecordingBuilder(body(cell, element("A", 6, text="next")), "Click two.")
    recording.click(4, (5, 65), effect=lambda: recording.node(6).update(text="over"))
    recording.click(6)
    trajectory = trajectory_of(recording, tmp_path)
    assert trajectory.pages[0].text[trajectory.actions[0].element] == "two"
    assert trajectory.pages[1].tampered.tolist() == [False, True, False, False, False, False]  # the parent of the text


def test_a_click_on_a_container_without_effect_is_ignored_unless_it_is_the_last(tmp_path: Path) -> None:
    recording = enter_text_recording()
    wasted = RecordingBuilder(enter_text_page(), recording.utterance)
    wasted.click(3, (150, 200))
    wasted.click(5)
    wasted.type(5, "Ada")
    wasted.click(6)
    assert actions_of(trajectory_of(wasted, tmp_path)) == actions_of(trajectory_of(recording, tmp_path))
    wasted.click(3, (150, 200))
    assert skip_reason(wasted, tmp_path) == "click on a container"


def test_a_press_without_a_click_and_without_effect_is_ignored(tmp_path: Path) -> None:
    recording = RecordingBuilder(
        body(element("BUTTON", 4, text="ok"), element("BUTTON", 5, text="okay")), "Click okay."
    )
    recording.mouse("mousedown", 4, (0, 50))
    recording.mouse("mouseup", 3, (62, 163))
    recording.click(5)
    assert actions_of(trajectory_of(recording, tmp_path)) == [("CLICK", 5, "")]


@pytest.mark.parametrize("event", ["mousedown", "mouseup"])
def test_a_last_press_is_a_click_where_the_mouse_went_down(tmp_path: Path, event: str) -> None:
    recording = RecordingBuilder(body(element("BUTTON", 4, text="ok"), element("BUTTON", 5, text="okay")), "Click ok.")
    recording.mouse("mousedown", 4, (0, 50))
    if event == "mouseup":
        recording.mouse("mouseup", 5, (0, 50))
    assert actions_of(trajectory_of(recording, tmp_path)) == [("CLICK", 4, "")]


def test_dragging_a_scroll_bar_is_ignored(tmp_path: Path) -> None:
    recording = RecordingBuilder(body(element("A", 4, text="here", box=(0, 300, 20, 10))), "Click here.")
    recording.mouse("mousedown", 3, (155, 60))
    recording.node(4)["top"] = 100
    recording.mouse("mouseup", 3, (155, 90))
    recording.click(4)
    assert actions_of(trajectory_of(recording, tmp_path)) == [("CLICK", 4, "")]


# ---- recordings that are skipped, and failures


def test_typed_text_that_is_not_in_the_instruction_is_skipped(tmp_path: Path) -> None:
    recording = RecordingBuilder(enter_text_page(), 'Enter "Ada" and press Submit.')
    recording.click(5)
    recording.type(5, "Eve")
    recording.click(6)
    assert skip_reason(recording, tmp_path) == "text not in instruction"


def test_a_native_list_is_skipped(tmp_path: Path) -> None:
    recording = RecordingBuilder(body(element("SELECT", 4), element("BUTTON", 6, text="Submit")), "Choose one.")
    recording.click(4)
    recording.click(6)
    assert skip_reason(recording, tmp_path) == "native list"


def test_a_slider_is_skipped_because_policies_cannot_type_into_it(tmp_path: Path) -> None:
    recording = RecordingBuilder(
        body(element("INPUT_range", 4, value="", text=""), element("BUTTON", 6, text="ok")), "Set it to 7."
    )
    recording.click(4)
    recording.type(4, "7")
    recording.click(6)
    assert skip_reason(recording, tmp_path) == "field takes no text"


def test_text_in_another_case_has_no_span_in_a_failure(tmp_path: Path) -> None:
    recording = RecordingBuilder(enter_text_page(), 'Enter "Ada" and press Submit.')
    recording.type(5, "ada")
    recording.click(6)
    assert actions_of(trajectory_of(recording, tmp_path, raw_reward=-1)) == [("TYPE", 5, ""), ("CLICK", 6, "")]


def test_a_checkbox_that_changes_without_a_click_is_skipped(tmp_path: Path) -> None:
    recording = checkboxes()
    recording.click(5, effect=lambda: recording.flip(5))
    recording.flip(8)
    recording.click(6)
    assert skip_reason(recording, tmp_path) == "checkbox states not reproduced"


def test_a_drag_that_changes_the_page_is_skipped(tmp_path: Path) -> None:
    recording = RecordingBuilder(body(element("LI", 4, text="a"), element("LI", 5, text="b")), "Sort b, a.")
    recording.mouse("mousedown", 4, (0, 50))
    recording.mouse("mouseup", 5, (0, 70), effect=lambda: recording.node(4).update(text="b"))
    recording.click(5)
    assert skip_reason(recording, tmp_path) == "drag"


def test_an_episode_that_a_key_ended_is_skipped(tmp_path: Path) -> None:
    recording = RecordingBuilder(enter_text_page(), 'Enter "Ada".')
    recording.click(5)
    recording.type(5, "Ada")
    recording.key(5, ENTER)
    assert skip_reason(recording, tmp_path) == "unsupported key"


def test_an_unknown_event_is_skipped(tmp_path: Path) -> None:
    recording = enter_text_recording()
    recording.event("touchstart", 5, 1)
    assert skip_reason(recording, tmp_path) == "unsupported event"


def test_a_recording_without_states_is_empty_and_one_without_events_has_no_action(tmp_path: Path) -> None:
    recording = RecordingBuilder(enter_text_page(), "Enter it.")
    assert skip_reason(recording, tmp_path) == "no action"
    recording.states = []
    assert skip_reason(recording, tmp_path) == "empty"


def test_a_failure_is_imported_with_its_reward_and_actions(tmp_path: Path) -> None:
    recording = RecordingBuilder(enter_text_page(), 'Enter "Ada" and press Submit.')
    recording.click(5)
    recording.type(5, "Eve")
    recording.click(6)
    imported = read_recording(recording.write(tmp_path / "t" / "t_1.json.gz", raw_reward=-1))
    assert (imported.clean, imported.reason) == (False, "failed")
    assert imported.episode is not None
    assert imported.episode.outcome.raw_reward == -1
    assert not imported.episode.outcome.success
    assert [action.verb for action in imported.episode.trajectory.actions] == [Verb.TYPE, Verb.CLICK]
    assert imported.episode.trajectory.actions[0].start == -1  # not in the instruction
