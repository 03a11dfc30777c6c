"""Features of elements beyond their own texts: kinds, labels, rows of tables, ranks, numbers, similar words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from giirl_core.nets import layout
from giirl_core.nets.colours import colour_names
from giirl_core.nets.features import Features, featurise
from giirl_core.nets.language import load_vectors
from giirl_core.nets.page_features import page_features
from giirl_core.nets.relations import NONE, Structure
from giirl_core.types import Goal, Page
from tests.learner.samples import dense_matches, page, vectors


def read(case_page: Page, utterance: str) -> Features:
    return featurise(case_page, Goal(utterance), vectors())


def flags(case_page: Page, utterance: str, column: int) -> list[float]:
    """[E] one column of the flags."""
    values: list[float] = read(case_page, utterance).element_flags[:, column].tolist()
    return values


def matched(case_page: Page, utterance: str, kind: int) -> list[list[str]]:
    """[E] the words of the goal that each element matches."""
    goal = Goal(utterance)
    table = dense_matches(featurise(case_page, goal, vectors()))[kind] > 0
    return [[token for token, found in zip(goal.tokens, row, strict=True) if found] for row in table]


def structure(case_page: Page) -> Structure:
    return page_features(case_page, vectors()).structure


def boxes(*rows: tuple[float, float, float, float]) -> NDArray[np.float32]:
    return np.array(rows, dtype=np.float32)


def test_the_kind_of_an_element_matches_words_for_its_tag_colour_classes_and_attributes() -> None:
    case = replace(
        page("input_checkbox", "div", "span", "i"),
        colour=("", "rgb(255, 0, 0)", "", ""),
        classes=("", "", "star-icon", ""),
        attributes=("", "", "", "trashBin"),
    )
    found = matched(case, "the checkbox, the red one, a star, a bin", layout.KIND_WORD)
    assert found == [["checkbox"], ["red"], ["star"], ["bin"]]


def test_classes_of_hovered_elements_are_not_read() -> None:
    plain, hovered = (replace(page("a:Ok"), classes=(names,)) for names in ("tab", "tab ui-state-hover"))
    one, other = read(plain, "Go."), read(hovered, "Go.")
    assert np.array_equal(one.element_ids, other.element_ids)


def test_whole_attributes_match_the_goal() -> None:
    case = replace(page("div", "div"), attributes=("", "trash"))
    assert matched(case, "Click the trash icon", layout.ATTRIBUTE_RUN) == [[], ["trash"]]


def test_a_field_has_the_words_and_matches_of_its_label() -> None:
    case = page("div", "t:First name", "input_text", "div", "t:Age", "input_text", parent=(-1, 0, 0, -1, 3, 3))
    features = read(case, "Enter the First name")
    assert structure(case).label.tolist() == [NONE, NONE, 1, NONE, NONE, 4]
    assert np.array_equal(features.element_ids[2, layout.ELEMENT_WORDS], features.element_ids[1, layout.ELEMENT_WORDS])
    assert matched(case, "Enter the First name", layout.LABEL_RUN)[2] == ["First", "name"]
    assert matched(case, "Enter the first thing", layout.LABEL_WORD)[2] == ["first"]
    assert flags(case, "Go.", layout.LABELLED) == [0, 0, 1, 0, 0, 1]


def test_elements_in_a_row_of_a_table_match_the_other_texts_of_the_row() -> None:
    case = page("ul", "li", "t:Ada", "button:Like", "li", "t:Bob", "button:Like", parent=(-1, 0, 1, 1, 0, 4, 4))
    found = matched(case, "Press the button of Ada", layout.GROUP_RUN)
    assert found == [[], [], [], ["Ada"], [], [], []]
    assert read(case, "Go.").group.tolist() == [0, 1, 1, 1, 4, 4, 4]
    assert flags(case, "Go.", layout.GROUPED) == [0, 0, 1, 1, 0, 1, 1]


def test_the_rank_of_an_element_counts_elements_with_the_same_tag_and_class() -> None:
    case = page("a:x", "p", "a:y", "a:z")
    assert structure(case).rank.tolist() == [1, 1, 2, 3]
    assert flags(case, "Go.", layout.RANK.start + 1) == [0, 0, 1, 0]
    assert flags(case, "Go.", layout.RANK_LAST) == [0, 1, 0, 1]
    assert flags(case, "Go.", layout.RANK_ONLY) == [0, 1, 0, 0]
    assert flags(case, "Click the 2nd link", layout.RANK_IN_GOAL) == [0, 0, 1, 0]


def test_numbers_of_elements_are_compared_with_those_of_the_goal() -> None:
    case = page("span:3", "span:-4", "span:May", "span:word")
    assert flags(case, "Set it to 3", layout.COMPARED + layout.EQUAL) == [1, 0, 0, 0]
    assert flags(case, "Set it to 4", layout.COMPARED + layout.SIGN) == [1, 1, -1, 0]
    assert flags(case, "Set it to 2 or 3", layout.COMPARED + layout.PER_NUMBER + layout.EQUAL) == [1, 0, 0, 0]
    assert flags(case, "Go.", layout.HAS_NUMBER) == [1, 1, 1, 0]


def test_the_number_of_leaves_acted_on_is_compared_with_the_goal() -> None:
    case = replace(page("a:x", "a:y", "a:z"), tampered=np.array([True, True, False]))
    assert flags(case, "Click two links", layout.COMPARED + layout.ACTED_EQUAL) == [1, 1, 1]
    assert flags(case, "Click three links", layout.COMPARED + layout.ACTED_SIGN) == [1, 1, 1]
    assert flags(case, "Go.", layout.ACTED_COUNT) == pytest.approx([np.log(3)] * 3)


def test_the_least_and_the_greatest_of_similar_elements_are_marked() -> None:
    case = page("div:$30", "div:$20", "div:$50", "p:$5")
    assert flags(case, "Go.", layout.LEAST) == [0, 1, 0, 0]
    assert flags(case, "Go.", layout.MOST) == [0, 0, 1, 0]


def test_an_element_whose_word_names_the_kind_of_another_is_marked_with_it() -> None:
    case = page("t:textarea", "textarea", "t:other")
    assert flags(case, "Go.", layout.NAMES_KIND) == [1, 0, 0]
    assert flags(case, "Go.", layout.KIND_NAMED) == [0, 1, 0]


def test_quoted_words_match_the_beginning_and_end_of_texts() -> None:
    case = page("div:Albania", "div:Spain")
    utterance = 'It starts with "Al" and ends with "ia".'
    assert flags(case, utterance, layout.PREFIX) == [1, 0]
    assert flags(case, utterance, layout.SUFFIX) == [1, 0]


def test_quoted_words_match_the_beginning_and_end_of_what_was_typed() -> None:
    case, utterance = page("input_text", "input_text", "input_text"), 'It starts with "Al" and ends with "ia".'
    typed = replace(case, value=("Albania", "New Albania", ""))
    assert flags(typed, utterance, layout.PREFIX) == [1, 0, 0]
    assert flags(typed, utterance, layout.SUFFIX) == [1, 1, 0]


def test_a_calendar_shows_whether_the_month_of_the_goal_is_later() -> None:
    case, first = page("span:March", "span:2016", "a:Next"), layout.CALENDAR.start
    for utterance, wanted in (("03/05/2016", [1, 1, 0, 0]), ("05/05/2016", [1, 0, 1, 0]), ("12/1/2015", [1, 0, 0, 1])):
        found = read(case, f"Select {utterance}").element_flags[:, layout.CALENDAR]
        assert found.tolist() == [wanted] * 3
    assert not flags(case, "Go.", first)[0]


def test_drawings_that_the_goal_describes_and_their_number_are_marked() -> None:
    case = replace(
        page("polygon", "circle", "circle", "button:1"),
        shape=("triangle 1,2 3,4 5,6", "circle", "circle", ""),
        colour=("red", "red", "blue", ""),
        box=boxes((0, 0, 20, 20), (0, 0, 20, 20), (0, 0, 8, 8), (0, 0, 9, 9)),
    )
    assert flags(case, "How many red circles are there?", layout.FITS) == [0, 1, 0, 0]
    assert flags(case, "How many small items are there?", layout.FITS) == [0, 0, 1, 0]
    assert flags(case, "How many small items are there?", layout.COUNTS_FITTING) == [0, 0, 0, 1]
    assert flags(case, "Go.", layout.FITS) == [0, 0, 0, 0]


def test_peers_of_an_element_that_was_acted_on_match_the_same_words() -> None:
    case = page("ul", "button:Ada", "button:Ada", "button:Bob", "i:Ada", parent=(-1, 0, 0, 0, 0))
    acted = replace(case, tampered=np.array([False, True, False, False, False]))
    assert flags(acted, "Click all Ada", layout.PEER) == [0, 0, 1, 0, 0]
    assert flags(acted, "Click all Ada", layout.HAS_PEER) == [1] * 5
    assert flags(case, "Click all Ada", layout.HAS_PEER) == [0] * 5


def test_a_goal_word_that_is_not_on_the_page_matches_the_most_similar_word() -> None:
    case, goal = page("a:automobile", "a:banana", "a:chair"), Goal("Find some car")
    features = featurise(case, goal, load_vectors("glove"))
    table = dense_matches(features)[layout.MOST_SIMILAR] > 0
    assert table[:, 2].tolist() == [True, False, False]
    assert features.token_ids[2, layout.OPEN]
    assert features.element_flags[0, layout.SIMILARITY] > features.element_flags[1, layout.SIMILARITY]


def most_similar(utterance: str, *elements: str) -> list[list[str]]:
    """[E] the words of the goal that each element is the likeliest match of."""
    goal = Goal(utterance)
    table = dense_matches(featurise(page(*elements), goal, load_vectors("glove")))[layout.MOST_SIMILAR] > 0
    return [[token for token, found in zip(goal.tokens, row, strict=True) if found] for row in table]


def test_every_goal_word_has_an_element_of_its_own() -> None:
    """`tiny` is the likeliest match of both words, and likelier that of `miniature`."""
    assert most_similar("Find petite and miniature", "a:tiny", "a:little") == [["miniature"], ["petite"]]


def test_elements_that_are_equally_like_a_word_match_it_together() -> None:
    assert most_similar("Find some car", "a:automobile", "a:automobile", "a:banana") == [["car"], ["car"], []]


def test_words_that_are_not_alike_match_nothing() -> None:
    assert most_similar("Find the banana", "a:parliament") == [[]]


@pytest.mark.parametrize("element", ["a:home", "a:Home"])
def test_an_element_that_is_named_takes_no_other_word(element: str) -> None:
    assert most_similar("Find home and residence", element, "a:apartment") == [[], ["residence"]]


def test_quoted_words_and_numbers_match_no_similar_word() -> None:
    assert most_similar('Find "car" and 2016', "a:automobile", "a:2017") == [[], []]
    assert most_similar("Find car and 2016", "a:automobile", "a:2017") == [["car"], []]


def test_numbers_one_above_a_number_on_the_page_are_next() -> None:
    case, goal = page("div:4", "span:Ada"), Goal("Guess between 0-9")
    marks = featurise(case, goal, load_vectors("glove")).token_flags[:, layout.NEXT] > 0
    assert [token for token, found in zip(goal.tokens, marks, strict=True) if found] == ["5"]


def test_a_field_that_holds_a_word_of_the_goal_takes_no_other_word() -> None:
    for value, free in (("Bob", False), ("Robert", True)):
        features = featurise(replace(page("input_text"), value=(value,)), Goal("Bob and Smith"), load_vectors("glove"))
        assert dense_matches(features)[layout.MOST_SIMILAR].any() == free


def done(case_page: Page, utterance: str) -> list[str]:
    """The words of the goal that are marked as done."""
    goal = Goal(utterance)
    marks = featurise(case_page, goal, load_vectors("glove")).token_flags[:, layout.DONE] > 0
    return [token for token, found in zip(goal.tokens, marks, strict=True) if found]


def test_words_of_the_goal_whose_elements_were_acted_on_are_done() -> None:
    case = page("a:automobile", "a:Bob", "a:Ada")
    acted = replace(case, tampered=np.array([True, False, True]))
    assert done(acted, "Pick a car, Bob and Ada") == ["car", "Ada"]
    assert done(case, "Pick a car, Bob and Ada") == []


def test_words_are_not_done_by_parts_of_texts_or_by_containers() -> None:
    part = replace(page("a:Ada Smith", "a:x"), tampered=np.array([True, False]))
    assert done(part, "Ada") == []
    container = replace(page("div:Ada", "a:x", parent=(-1, 0)), tampered=np.array([True, False]))
    assert done(container, "Ada") == []


def test_relations_tell_parents_children_and_neighbours_apart() -> None:
    case = replace(
        page("div", "a:x", "a:y", "a:z", "a:w", parent=(-1, 0, 0, 0, 0)),
        box=boxes((0, 0, 100, 100), (0, 0, 10, 10), (30, 0, 10, 10), (0, 30, 10, 10), (30, 30, 10, 10)),
    )
    codes = structure(case).relations
    tree, screen = codes // layout.SCREEN_RELATIONS, codes % layout.SCREEN_RELATIONS
    assert tree[1].tolist() == [1, 0, 5, 5, 5]  # parent, itself, siblings
    assert tree[0].tolist() == [0, 3, 3, 3, 3]  # children
    assert len({*screen[1, 1:].tolist()}) == 4  # itself, right, below, diagonal
    assert screen[1, 2] == screen[3, 4]
    assert screen[1, 2] != screen[2, 1]
    assert screen[1, 4] != screen[3, 2]  # falling and rising diagonals
    assert codes.max() < layout.RELATIONS


def test_cached_pages_differ_in_focus_and_in_elements_acted_on() -> None:
    plain = page("a:x", "a:y")
    changed = replace(plain, focused=np.array([True, False]), tampered=np.array([False, True]))
    assert flags(plain, "Go.", layout.FOCUSED) == flags(plain, "Go.", layout.TAMPERED) == [0, 0]
    assert flags(changed, "Go.", layout.FOCUSED) == [1, 0]
    assert flags(changed, "Go.", layout.TAMPERED) == [0, 1]


def test_every_column_of_a_page_is_part_of_the_key_of_the_cache() -> None:
    plain = page("a:x", "a:y")
    changes = [{name: ("", "red")} for name in ("tag", "text", "value", "classes", "attributes", "colour", "shape")]
    others = [replace(plain, **change) for change in changes]  # type: ignore[arg-type]
    others += [replace(plain, parent=np.array([-1, 0], np.int16)), replace(plain, box=plain.box + 5)]
    for other in others:
        one, two = read(plain, "red"), read(other, "red")
        assert any(
            not np.array_equal(getattr(one, name), getattr(two, name))
            for name in ("element_ids", "element_flags", "relations")
        )


def test_colours_have_names() -> None:
    assert colour_names("rgb(0, 0, 255)") == ("blue",)
    assert colour_names("#ff0000") == ("red",)
    assert colour_names("rgb(250, 10, 10)") == ("red",)
    assert colour_names("rgb(130, 130, 130)") == ("gray",)
    assert colour_names("") == colour_names("url(x)") == ()
    assert colour_names(f"rgb({'9' * 400}, 0, 0)") == ()


def test_a_shape_of_blanks_is_none() -> None:
    plain = page("circle:x")
    blank = replace(plain, shape=("  ",))
    assert np.array_equal(
        read(blank, "Click the circle.").element_flags, read(plain, "Click the circle.").element_flags
    )
