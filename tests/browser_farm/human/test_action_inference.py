"""What a person did in a recording, found again; and what is refused as a demonstration."""

from __future__ import annotations

import copy
import zlib
from pathlib import Path

import pytest

from browser_farm.human.recordings import read_recording
from giirl_core.types import DEMONSTRATION, Trajectory, Verb
from tests.browser_farm.human.recording_pages import CONTROL, ENTER, TAB, Tape, body, element, entered, form, words


def done(tape: Tape, tmp_path: Path, raw_reward: float = 1) -> Trajectory:
    recorded = read_recording(tape.write(tmp_path / "some-task" / "some-task_A_d1.json.gz", raw_reward))
    assert recorded.reason == ("" if raw_reward == 1 else "failed")
    assert recorded.episode is not None
    return recorded.episode.trajectory


def refused(tape: Tape, tmp_path: Path) -> str:
    recorded = read_recording(tape.write(tmp_path / "some-task" / "some-task_A_d1.json.gz"))
    assert recorded.episode is None
    assert not recorded.clean
    return recorded.reason


def deeds(trajectory: Trajectory) -> list[tuple[str, int, str]]:
    """(verb, ref, text) of every action."""
    return [
        (action.verb.name, int(page.ref[action.element]), action.text(trajectory.goal))
        for page, action in zip(trajectory.pages, trajectory.actions, strict=True)
    ]


def checkboxes() -> Tape:
    box = element("INPUT_checkbox", 5, value=False, text="", box=(5, 50, 13, 13))
    label = element("LABEL", 4, box, words("bees"), box=(5, 50, 90, 20))
    other = element("INPUT_checkbox", 8, value=False, text="", box=(5, 75, 13, 13))
    page = body(label, other, element("BUTTON", 6, text="Submit", box=(20, 100, 90, 30)))
    return Tape(page, "Select bees and click Submit.")


# ---- what the page looks like


def test_the_page_has_a_row_for_every_visible_element_but_body_wrap_and_instruction(tmp_path: Path) -> None:
    query = element("DIV", 9, text="Click the link.", id="query")
    text = element("P", 4, words("see"), element("BR", 7), element("A", 5, text="  the \n link "), classes="big")
    tape = Tape(body(query, text, element("circle", 6, classes={})), "Click the link.")
    tape.click(5)
    page = done(tape, tmp_path).pages[0]
    assert page.tag == ("div", "p", "t", "a", "circle")
    assert page.text == ("", "", "see", "the link", "")
    assert page.classes == ("", "big", "", "", "")
    assert page.parent.tolist() == [-1, 0, 1, 1, 0]
    assert page.box[2].tolist() == [30, 50, 60, 20]


def test_the_form_that_the_first_collection_wrapped_pages_in_is_no_row(tmp_path: Path) -> None:
    page = body(element("BUTTON", 4, text="ok"))
    plain, wrapped = Tape(page, "Click ok."), copy.deepcopy(page)
    wrapped["children"] = [element("FORM", 99, *wrapped["children"], id="mturk_form")]
    inside = Tape(wrapped, "Click ok.")
    for tape in (plain, inside):
        tape.click(4)
    assert done(plain, tmp_path).pages[0].tag == done(inside, tmp_path).pages[0].tag == ("div", "button")


def test_checkboxes_read_checked_or_nothing_and_fields_what_they_hold(tmp_path: Path) -> None:
    tape = checkboxes()
    tape.click(5, effect=lambda: tape.flip(5))
    tape.click(6)
    first, second = done(tape, tmp_path).pages
    assert (first.value[2], second.value[2]) == ("", "checked")


# ---- what the person did


def test_a_click_is_one_action_on_the_page_before_the_button_went_down(tmp_path: Path) -> None:
    tape = Tape(body(element("BUTTON", 4, text="yes"), element("BUTTON", 5, text="no")), 'Click on "no".')
    tape.click(5, effect=lambda: tape.node(5).update(text="gone"))
    trajectory = done(tape, tmp_path)
    assert deeds(trajectory) == [("CLICK", 5, "")]
    assert trajectory.pages[0].text == ("", "yes", "no")
    assert not trajectory.pages[0].focused.any()


def test_typing_is_decided_before_the_click_that_focused_the_field(tmp_path: Path) -> None:
    trajectory = done(entered("Ada"), tmp_path)
    assert deeds(trajectory) == [("TYPE", 5, "Ada"), ("CLICK", 6, "")]
    before, after = trajectory.pages
    assert before.value[2] == ""
    assert not before.focused.any()
    assert not before.tampered.any()
    assert after.value[2] == "Ada"
    assert after.focused.tolist() == after.tampered.tolist() == [False, False, True, False]


def test_a_demonstration_carries_no_score_and_a_seed_from_its_name(tmp_path: Path) -> None:
    trajectory = done(entered(), tmp_path)
    assert trajectory.policy_version == DEMONSTRATION
    assert trajectory.task == "some-task"
    assert trajectory.seed == zlib.crc32(b"some-task_A_d1")
    assert not trajectory.behaviour_logp.any()
    assert not trajectory.rewards.any()


def test_typing_on_in_the_same_field_is_one_action_with_the_final_text(tmp_path: Path) -> None:
    tape = Tape(form(), "Enter Ada Lovelace, then press Submit.")
    tape.click(5)
    tape.type(5, "Ada")
    tape.click(5)
    tape.type(5, " Lovelace")
    tape.click(6)
    assert deeds(done(tape, tmp_path)) == [("TYPE", 5, "Ada Lovelace"), ("CLICK", 6, "")]


def test_tab_and_copying_are_nothing_by_themselves(tmp_path: Path) -> None:
    fields = [element("INPUT_password", ref, value="", text="") for ref in (4, 5)]
    tape = Tape(body(*fields, element("BUTTON", 6, text="Submit")), 'Enter "pass" twice.')
    tape.click(4)
    tape.type(4, "pass")
    tape.key(4, CONTROL)
    tape.key(4, ord("C"))
    tape.key(4, TAB)
    tape.focus(5)
    tape.type(5, "pass")
    tape.click(6)
    trajectory = done(tape, tmp_path)
    assert deeds(trajectory) == [("TYPE", 4, "pass"), ("TYPE", 5, "pass"), ("CLICK", 6, "")]
    assert trajectory.pages[1].focused.tolist() == [False, True, False, False]  # as before Tab was pressed


@pytest.mark.parametrize("with_keys", [True, False])
def test_a_pasted_text_counts_as_typed(tmp_path: Path, with_keys: bool) -> None:
    tape = Tape(form(), 'Enter "Ada" and press Submit.')
    tape.click(5)
    if with_keys:
        tape.key(5, CONTROL)
        tape.key(5, ord("V"))
    tape.node(5)["value"] = "Ada"
    tape.click(6)
    assert deeds(done(tape, tmp_path)) == [("TYPE", 5, "Ada"), ("CLICK", 6, "")]


def test_enter_on_a_button_is_a_click_on_it(tmp_path: Path) -> None:
    tape = Tape(form(), 'Enter "Ada" and press Submit.')
    tape.click(5)
    tape.type(5, "Ada")
    tape.key(5, TAB)
    tape.focus(6)
    tape.key(6, ENTER)
    tape.mouse("click", 6, (0, 0))
    assert deeds(done(tape, tmp_path)) == [("TYPE", 5, "Ada"), ("CLICK", 6, "")]


@pytest.mark.parametrize("passed_on", [True, False])
def test_a_click_on_a_label_is_one_on_the_checkbox_that_flipped(tmp_path: Path, passed_on: bool) -> None:
    tape = checkboxes()
    tape.click(4, (20, 55))
    tape.flip(5)
    if passed_on:
        tape.mouse("click", 5, (0, 0))
    tape.click(6)
    trajectory = done(tape, tmp_path)
    assert deeds(trajectory) == [("CLICK", 5, ""), ("CLICK", 6, "")]
    assert trajectory.pages[0].value[2] == ""


def test_a_click_on_a_container_goes_to_the_text_under_the_mouse(tmp_path: Path) -> None:
    cell = element("DIV", 4, words("one", (0, 50, 20, 10)), words("two", (0, 60, 20, 10)), element("I", 5))
    tape = Tape(body(cell, element("A", 6, text="next")), "Click two.")
    tape.click(4, (5, 65), effect=lambda: tape.node(6).update(text="over"))
    tape.click(6)
    trajectory = done(tape, tmp_path)
    assert trajectory.pages[0].text[trajectory.actions[0].element] == "two"
    assert trajectory.pages[1].tampered.tolist() == [False, True, False, False, False, False]  # its element


def test_a_wasted_click_on_a_container_goes_but_never_the_last_one(tmp_path: Path) -> None:
    tape = entered()
    wasted = Tape(form(), tape.utterance)
    wasted.click(3, (150, 200))
    wasted.click(5)
    wasted.type(5, "Ada")
    wasted.click(6)
    assert deeds(done(wasted, tmp_path)) == deeds(done(tape, tmp_path))
    wasted.click(3, (150, 200))
    assert refused(wasted, tmp_path) == "acts on a container"


def test_pulling_a_scroll_bar_is_no_action(tmp_path: Path) -> None:
    tape = Tape(body(element("A", 4, text="here", box=(0, 300, 20, 10))), "Click here.")
    tape.mouse("mousedown", 3, (155, 60))
    tape.node(4)["top"] = 100
    tape.mouse("mouseup", 3, (155, 90))
    tape.click(4)
    assert deeds(done(tape, tmp_path)) == [("CLICK", 4, "")]


# ---- what is no demonstration, and why


def test_text_that_is_not_in_the_instruction_is_refused(tmp_path: Path) -> None:
    tape = Tape(form(), 'Enter "Ada" and press Submit.')
    tape.click(5)
    tape.type(5, "Eve")
    tape.click(6)
    assert refused(tape, tmp_path) == "text not in instruction"


def test_a_choice_from_a_native_list_is_refused(tmp_path: Path) -> None:
    tape = Tape(body(element("SELECT", 4), element("BUTTON", 6, text="Submit")), "Choose one.")
    tape.click(4)
    tape.click(6)
    assert refused(tape, tmp_path) == "native list"


def test_a_slider_is_refused_because_policies_cannot_type_into_it(tmp_path: Path) -> None:
    tape = Tape(body(element("INPUT_range", 4, value="", text=""), element("BUTTON", 6, text="ok")), "Set it to 7.")
    tape.click(4)
    tape.type(4, "7")
    tape.click(6)
    assert refused(tape, tmp_path) == "field takes no text"


def test_a_failure_keeps_the_letters_that_were_typed_not_those_that_were_asked_for(tmp_path: Path) -> None:
    tape = Tape(form(), 'Enter "Ada" and press Submit.')
    tape.type(5, "ada")
    tape.click(6)
    assert deeds(done(tape, tmp_path, raw_reward=-1)) == [("TYPE", 5, ""), ("CLICK", 6, "")]


def test_checkboxes_that_flip_without_a_click_are_refused(tmp_path: Path) -> None:
    tape = checkboxes()
    tape.click(5, effect=lambda: tape.flip(5))
    tape.flip(8)
    tape.click(6)
    assert refused(tape, tmp_path) == "checkboxes do not follow"


def test_a_drag_that_changes_the_page_is_refused(tmp_path: Path) -> None:
    tape = Tape(body(element("LI", 4, text="a"), element("LI", 5, text="b")), "Sort b, a.")
    tape.mouse("mousedown", 4, (0, 50))
    tape.mouse("mouseup", 5, (0, 70), effect=lambda: tape.node(4).update(text="b"))
    tape.click(5)
    assert refused(tape, tmp_path) == "drag"


def test_an_episode_that_a_key_ended_is_refused(tmp_path: Path) -> None:
    tape = Tape(form(), 'Enter "Ada".')
    tape.click(5)
    tape.type(5, "Ada")
    tape.key(5, ENTER)
    assert refused(tape, tmp_path) == "unsupported key"


def test_an_unknown_event_is_refused(tmp_path: Path) -> None:
    tape = entered()
    tape.event("touchstart", 5, 1)
    assert refused(tape, tmp_path) == "unsupported action"


def test_a_recording_of_nothing_is_empty_and_one_without_deeds_has_no_action(tmp_path: Path) -> None:
    tape = Tape(form(), "Enter it.")
    assert refused(tape, tmp_path) == "no action"
    tape.states = []
    assert refused(tape, tmp_path) == "empty"


def test_a_failure_is_kept_with_its_reward_and_what_was_done(tmp_path: Path) -> None:
    tape = Tape(form(), 'Enter "Ada" and press Submit.')
    tape.click(5)
    tape.type(5, "Eve")
    tape.click(6)
    recorded = read_recording(tape.write(tmp_path / "t" / "t_1.json.gz", raw_reward=-1))
    assert (recorded.clean, recorded.reason) == (False, "failed")
    assert recorded.episode is not None
    assert recorded.episode.outcome.raw_reward == -1
    assert not recorded.episode.outcome.success
    assert [action.verb for action in recorded.episode.trajectory.actions] == [Verb.TYPE, Verb.CLICK]
    assert recorded.episode.trajectory.actions[0].start == -1  # not in the instruction
