"""What is drawn on a page: outlines where the elements are, numbers where they hide nothing, the highest marked."""

from __future__ import annotations

from dataclasses import replace

import pytest

from giirl.report.overlay import MOST_LABELS, Box, draw_shot, number, place_labels, window_of
from giirl_core.types import Action, Verb
from tests.giirl.report.examples import SCALE, TWO, judged, page

WINDOW = Box(0, 50, 160, 160)


def test_numbers_stand_beside_their_elements_and_hide_neither_elements_nor_each_other() -> None:
    boxes = [Box(10, 60, 40, 20), Box(10, 85, 60, 20), Box(120, 60, 38, 20)]
    labels = place_labels(boxes, ["+4.8", "-3.2", "0.0"], WINDOW)
    for at, label in enumerate(labels):
        assert all(label.overlap(box) == 0 for box in boxes)
        assert all(label.overlap(other) == 0 for other in labels[at + 1 :])
        assert label.overlap(WINDOW) == pytest.approx(label.width * label.height)
    assert labels[2].x < boxes[2].x  # no room at its right


def test_a_wide_element_has_its_number_inside_at_the_right_end() -> None:
    (label,) = place_labels([Box(2, 60, 156, 12)], ["-5.0"], WINDOW)
    assert label.x > 100
    assert label.y >= 60


def test_every_element_in_sight_is_outlined_with_its_sign_and_the_highest_stands_out() -> None:
    shot = draw_shot(TWO, judged(-3.2, 4.8), SCALE)
    assert [(mark.good, mark.box.y) for mark in shot.marks] == [(True, 90), (False, 60)]
    assert [(label.text, label.top) for label in shot.labels] == [("+4.8", True), ("\N{MINUS SIGN}3.2", False)]
    assert shot.marks[0].opacity > shot.marks[1].opacity


def test_what_lies_below_the_fold_is_not_drawn_and_what_crosses_it_is_cut() -> None:
    tall = page(("button", "a", (0, 60, 160, 20)), ("button", "b", (0, 200, 20, 40)), ("button", "c", (0, 300, 9, 9)))
    shot = draw_shot(tall, judged(1.0, 2.0, 3.0, chosen=2), SCALE)
    assert [mark.box for mark in shot.marks] == [Box(0, 200, 20, 10), Box(0, 60, 160, 20)]
    assert shot.target is None
    assert [label.top for label in shot.labels] == [True, False]


def test_on_a_crowded_page_all_are_outlined_and_the_highest_have_numbers() -> None:
    rows = [("button", str(i), (10.0 * (i % 12), 60 + 12.0 * (i // 12), 8.0, 8.0)) for i in range(40)]
    shot = draw_shot(page(*rows), judged(*(i / 10 for i in range(40))), SCALE)
    assert len(shot.marks) == 40
    assert [label.text for label in shot.labels] == [f"+{i / 10:.1f}" for i in range(39, 39 - MOST_LABELS, -1)]


def test_without_a_reward_the_policy_is_drawn_alone() -> None:
    shot = draw_shot(TWO, judged(chosen=1), SCALE)
    assert (shot.marks, shot.labels) == ((), ())
    assert shot.target == Box(10, 90, 60, 20)
    assert "Cancel" in shot.does


def test_what_is_typed_stands_behind_what_the_field_holds() -> None:
    field = page(("input_text", "", (10, 60, 100, 20)))
    typing = Action(verb=Verb.TYPE, element=0, start=0, end=1)
    empty = draw_shot(field, replace(judged(), choice=typing), SCALE)
    full = draw_shot(replace(field, value=("Ada",)), replace(judged(), choice=typing), SCALE)
    assert empty.typed == full.typed == "Click on"
    assert empty.typed_x < 20 < full.typed_x < 100


@pytest.mark.parametrize(("reward", "text"), [(0.04, "0.0"), (-0.04, "0.0"), (1.26, "+1.3"), (-5, "\N{MINUS SIGN}5.0")])
def test_a_reward_is_written_with_its_sign(reward: float, text: str) -> None:
    assert number(reward) == text


def test_the_window_begins_below_the_instruction_and_ends_below_the_last_element() -> None:
    assert window_of(page(("button", "a", (0, 50, 10, 150)))) == Box(0, 50, 160, 159)
    assert window_of(page(("button", "a", (0, 50, 10, 10)))) == Box(0, 50, 160, 80)
    assert window_of(page()) == Box(0, 0, 160, 210)
