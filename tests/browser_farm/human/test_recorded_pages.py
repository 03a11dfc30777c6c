"""The pages of recordings: the same table of rows that Chrome's page reader gives."""

from __future__ import annotations

import copy
from pathlib import Path

from tests.browser_farm.human.recording_builder import RecordingBuilder, bare_text, body, element, trajectory_of


def test_a_page_has_a_row_for_every_visible_element_except_body_wrap_and_instruction(tmp_path: Path) -> None:
    query = element("DIV", 9, text="Click the link.", id="query")
    text = element("P", 4, bare_text("see"), element("BR", 7), element("A", 5, text="  the \n link "), classes="big")
    recording = RecordingBuilder(body(query, text, element("circle", 6, classes={})), "Click the link.")
    recording.click(5)
    page = trajectory_of(recording, tmp_path).pages[0]
    assert page.tag == ("div", "p", "t", "a", "circle")
    assert page.text == ("", "", "see", "the link", "")
    assert page.classes == ("", "big", "", "", "")
    assert page.parent.tolist() == [-1, 0, 1, 1, 0]
    assert page.box[2].tolist() == [30, 50, 60, 20]


def test_the_form_around_the_pages_of_the_first_collection_is_not_a_row(tmp_path: Path) -> None:
    page = body(element("BUTTON", 4, text="ok"))
    plain, wrapped = RecordingBuilder(page, "Click ok."), copy.deepcopy(page)
    wrapped["children"] = [element("FORM", 99, *wrapped["children"], id="mturk_form")]
    inside = RecordingBuilder(wrapped, "Click ok.")
    for recording in (plain, inside):
        recording.click(4)
        assert trajectory_of(recording, tmp_path).pages[0].tag == ("div", "button")


def test_the_value_of_a_checkbox_is_checked_or_empty(tmp_path: Path) -> None:
    box = element("INPUT_checkbox", 5, value=False, text="", box=(5, 50, 13, 13))
    page = body(box, element("BUTTON", 6, text="Submit", box=(20, 100, 90, 30)))
    recording = RecordingBuilder(page, "Select it and click Submit.")
    recording.click(5, effect=lambda: recording.flip(5))
    recording.click(6)
    first, second = trajectory_of(recording, tmp_path).pages
    assert (first.value[1], second.value[1]) == ("", "checked")


def test_classes_of_the_element_below_the_mouse_are_left_out(tmp_path: Path) -> None:
    tab = element("A", 5, text="Ok", classes="tab ui-state-hover")
    item = element("LI", 6, text="Paris", classes="ui-menu-item-wrapper ui-state-active", box=(0, 90, 160, 20))
    recording = RecordingBuilder(body(tab, item), "Click Ok.")
    recording.click(5)
    page = trajectory_of(recording, tmp_path).pages[0]
    assert page.classes[1:] == ("tab", "ui-menu-item-wrapper")


def test_text_for_screen_readers_is_left_out(tmp_path: Path) -> None:
    hidden = element(
        "DIV", 6, element("DIV", 7, text="Paris"), classes="ui-helper-hidden-accessible", box=(-1, 9, 1, 1)
    )
    recording = RecordingBuilder(body(element("A", 5, text="Paris"), hidden), "Click Paris.")
    recording.click(5)
    assert trajectory_of(recording, tmp_path).pages[0].tag == ("div", "a")


def test_boxes_are_those_before_scrolling(tmp_path: Path) -> None:
    items = [element("LI", 10 + i, text=f"item {i}", box=(0, 10 + 20 * i, 160, 20)) for i in range(4)]
    recording = RecordingBuilder(body(element("UL", 4, *items, box=(0, 50, 160, 80))), "Click item 3.")
    recording.click(13)
    page = trajectory_of(recording, tmp_path).pages[0]
    assert page.box[:, 1].tolist() == [50, 50, 50, 70, 90, 110]


def test_attributes_colours_and_shapes_are_recorded(tmp_path: Path) -> None:
    patch = element("DIV", 5, id="red-one", bgColor="rgb(255, 0, 0)")
    button = element("BUTTON", 6, id="ok", text="Ok", bgColor="rgb(239, 239, 239)", box=(0, 90, 160, 20))
    drawing = element("polygon", 7, classes={}, box=(0, 120, 20, 20))
    recording = RecordingBuilder(body(patch, button, drawing), "Click Ok.")
    recording.click(6)
    page = trajectory_of(recording, tmp_path).pages[0]
    assert page.attributes[1:] == ("red-one", "ok", "")
    assert page.colour == ("", "rgb(255, 0, 0)", "", "")
    assert page.shape == ("", "", "", "triangle")
