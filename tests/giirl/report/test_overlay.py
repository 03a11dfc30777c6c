"""The overlay outlines elements, places labels where they cover nothing, and marks the highest reward."""

from __future__ import annotations

from dataclasses import replace

import pytest

from giirl.report.overlay import MAX_LABELS, Box, draw_overlay, format_reward, place_labels, visible_area
from giirl_core.types import Action, Verb
from tests.giirl.report.examples import SCALE, TWO, page, scored

WINDOW = Box(0, 50, 160, 160)


def test_labels_stand_next_to_their_elements_and_cover_neither_elements_nor_labels() -> None:
    boxes = [Box(10, 60, 40, 20), Box(10, 85, 60, 20), Box(120, 60, 38, 20)]
    labels = place_labels(boxes, ["+4.8", "-3.2", "0.0"], WINDOW)
    for at, label in enumerate(labels):
        assert all(label.overlap(box) == 0 for box in boxes)
        assert all(label.overlap(other) == 0 for other in labels[at + 1 :])
        assert label.overlap(WINDOW) == pytest.approx(label.width * label.height)
    assert labels[2].x < boxes[2].x  # no room on the right


def test_a_wide_element_has_its_label_inside_at_the_right_end() -> None:
    (label,) = place_labels([Box(2, 60, 156, 12)], ["-5.0"], WINDOW)
    assert label.x > 100
    assert label.y >= 60


def test_every_visible_element_is_marked_by_sign_and_the_highest_reward_is_highlighted() -> None:
    overlay = draw_overlay(TWO, scored(-3.2, 4.8), SCALE)
    assert [(mark.above_middle, mark.box.y) for mark in overlay.marks] == [(True, 90), (False, 60)]
    assert [(label.text, label.top) for label in overlay.labels] == [("+4.8", True), ("\N{MINUS SIGN}3.2", False)]
    assert overlay.marks[0].opacity > overlay.marks[1].opacity


def test_elements_below_the_visible_area_are_left_out_or_cut() -> None:
    tall = page(("button", "a", (0, 60, 160, 20)), ("button", "b", (0, 200, 20, 40)), ("button", "c", (0, 300, 9, 9)))
    overlay = draw_overlay(tall, scored(1.0, 2.0, 3.0, chosen=2), SCALE)
    assert [mark.box for mark in overlay.marks] == [Box(0, 200, 20, 10), Box(0, 60, 160, 20)]
    assert overlay.target is None
    assert [label.top for label in overlay.labels] == [True, False]


def test_on_a_crowded_page_only_the_highest_rewards_are_labelled() -> None:
    rows = [("button", str(i), (10.0 * (i % 12), 60 + 12.0 * (i // 12), 8.0, 8.0)) for i in range(40)]
    overlay = draw_overlay(page(*rows), scored(*(i / 10 for i in range(40))), SCALE)
    assert len(overlay.marks) == 40
    assert [label.text for label in overlay.labels] == [f"+{i / 10:.1f}" for i in range(39, 39 - MAX_LABELS, -1)]


def test_without_a_reward_only_the_policy_action_is_drawn() -> None:
    overlay = draw_overlay(TWO, scored(chosen=1), SCALE)
    assert (overlay.marks, overlay.labels) == ((), ())
    assert overlay.target == Box(10, 90, 60, 20)
    assert "Cancel" in overlay.action


def test_typed_text_is_drawn_to_the_right_of_the_text_in_the_field() -> None:
    field = page(("input_text", "", (10, 60, 100, 20)))
    typing = Action(verb=Verb.TYPE, element=0, start=0, end=1)
    empty = draw_overlay(field, replace(scored(), policy_action=typing), SCALE)
    full = draw_overlay(replace(field, value=("Ada",)), replace(scored(), policy_action=typing), SCALE)
    assert empty.typed_text == full.typed_text == "Click on"
    assert empty.typed_x < 20 < full.typed_x < 100


@pytest.mark.parametrize(("reward", "text"), [(0.04, "0.0"), (-0.04, "0.0"), (1.26, "+1.3"), (-5, "\N{MINUS SIGN}5.0")])
def test_a_reward_is_formatted_with_its_sign(reward: float, text: str) -> None:
    assert format_reward(reward) == text


def test_the_visible_area_starts_below_the_instruction_and_ends_below_the_last_element() -> None:
    assert visible_area(page(("button", "a", (0, 50, 10, 150)))) == Box(0, 50, 160, 159)
    assert visible_area(page(("button", "a", (0, 50, 10, 10)))) == Box(0, 50, 160, 80)
    assert visible_area(page()) == Box(0, 0, 160, 210)
