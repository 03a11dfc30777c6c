"""Goals, actions, pages, trajectories, seeds and weights: what they compute, and which values they refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl_core.gestures import BASIC
from giirl_core.keys import parse_chord
from giirl_core.types import (
    Action,
    Command,
    EpisodeSpec,
    Goal,
    Observation,
    Outcome,
    Purpose,
    Verb,
    is_held_out,
    page_seed,
)
from giirl_core.weights import Weights
from tests.learner.samples import FLAT, LONG, page, trajectory

CLICK = Action(verb=Verb.CLICK, element=0)


@given(st.text().filter(lambda text: bool(text.split())))
def test_every_span_of_a_goal_has_the_characters_of_the_utterance(utterance: str) -> None:
    goal = Goal(utterance)
    assert [goal.span(i, i) for i in range(len(goal.tokens))] == list(goal.tokens)
    assert goal.span(0, len(goal.tokens) - 1) == utterance.strip()


@given(st.text(alphabet='ab" .', min_size=1).filter(lambda text: bool(text.split())), st.data())
def test_the_span_that_find_returns_equals_the_text(utterance: str, data: st.DataObject) -> None:
    goal = Goal(utterance)
    start = data.draw(st.integers(0, len(goal.tokens) - 1))
    end = data.draw(st.integers(start, len(goal.tokens) - 1))
    text = goal.span(start, end)
    assert goal.span(*goal.find(text)) == text


def test_a_range_implies_its_numbers() -> None:
    goal = Goal("Guess the number between 0-9 and press Submit.")
    assert goal.span(*goal.find("7")) == "7"
    assert goal.find("9") == (6, 6)
    assert goal.tokens[len(goal.offsets) :] == ("1", "2", "3", "4", "5", "6", "7", "8")
    assert goal.span(len(goal.offsets) - 1, len(goal.offsets)) == ". 1"
    assert Goal("between 3 and 5").tokens == ("between", "3", "and", "5", "4")
    assert Goal("between 5 and 3").tokens == ("between", "5", "and", "3")
    assert Goal("between 0-999999999").find("7") == (-1, -1)


def test_find_prefers_quoted_words() -> None:
    goal = Goal('Press press the button "press" and press on.')
    assert goal.find("press") == (5, 5)
    assert goal.find("Press") == (0, 0)


def test_find_compares_case_and_spacing() -> None:
    goal = Goal('Enter "Ada  Lovelace".')
    assert goal.find("Ada  Lovelace") == (2, 3)
    assert goal.find("Ada Lovelace") == (-1, -1)
    assert goal.find("ada  lovelace") == (-1, -1)
    assert goal.find("") == (-1, -1)


def test_a_goal_without_a_word_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Goal\.utterance is '  ', wanted at least one word"):
        Goal("  ")


def test_the_text_of_an_action_is_its_span_of_the_goal() -> None:
    goal = Goal("Type one two.")
    assert Action(verb=Verb.TYPE, element=0, start=1, end=2).text(goal) == "one two"
    assert Action(verb=Verb.TYPE, element=0).text(goal) == ""
    assert Action(verb=Verb.CLICK, element=0).text(goal) == ""


def test_leaves_have_no_children_and_text_fields_are_typable() -> None:
    assert LONG.leaf.tolist() == [False, True, True, True, True]
    assert LONG.typable.tolist() == [False, False, False, True, True]


@pytest.mark.parametrize(
    "change",
    [
        {"text": ("Ok",)},
        {"ref": np.zeros(2, dtype=np.int32)},
        {"box": np.zeros((3, 3), dtype=np.float32)},
        {"parent": np.array([0, -1, -1], dtype=np.int16)},
        {"parent": np.array([-1, 2, -1], dtype=np.int16)},
    ],
)
def test_a_page_whose_columns_disagree_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"Page\."):
        replace(FLAT, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pages": ()}, "at least one step"),
        ({"actions": (CLICK, CLICK)}, "actions has 2 steps"),
        ({"rewards": np.zeros(3, dtype=np.float32)}, "rewards has 3 steps"),
        ({"behaviour_logp": np.zeros(0, dtype=np.float32)}, "behaviour_logp has 0 steps"),
        ({"actions": (replace(CLICK, element=3),)}, "element 3, its page has 3"),
        ({"actions": (Action(verb=Verb.DRAG, element=0, to=3),)}, "element 3, its page has 3"),
        ({"actions": (Action(verb=Verb.TYPE, element=0, start=0, end=3),)}, "the goal has 3"),
    ],
)
def test_an_inconsistent_trajectory_is_refused(change: dict[str, object], message: str) -> None:
    good = trajectory("Click Ok.", [FLAT], [CLICK])
    with pytest.raises(ValueError, match=message):
        replace(good, **change)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"verb": Verb.CLICK, "literal": "x"}, "CLICK takes no 'literal', got 'x'"),
        ({"verb": Verb.HOVER, "by": (1.0, 0.0)}, "HOVER takes no 'by'"),
        ({"verb": Verb.SCROLL, "to": 1}, "SCROLL takes no 'to'"),
        ({"verb": Verb.WAIT, "at": (1.0, 1.0)}, "WAIT takes no 'at'"),
        ({"verb": Verb.CLICK, "element": -2}, "Action.element is -2"),
        ({"verb": Verb.TYPE, "start": 2, "end": 1}, r"start\.\.end is 2\.\.1"),
        ({"verb": Verb.TYPE, "start": 0, "end": 0, "literal": "x"}, "literal 'x' and tokens 0..0"),
        ({"verb": Verb.CLICK, "at": (float("nan"), 0.0)}, "finite"),
        ({"verb": Verb.PRESS}, "'' is not a key"),
        ({"verb": Verb.PRESS, "literal": "Ctrl+c"}, r"'Ctrl\+c' is not a key: .* as in Control\+c"),
        ({"verb": Verb.PRESS, "literal": "Control+"}, "is not a key"),
    ],
)
def test_an_action_with_a_bad_value_or_an_unused_field_is_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Action(**fields)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("keys", "modifiers", "key"),
    [("a", 0, "a"), ("+", 0, "+"), ("Enter", 0, "Enter"), ("Control++", 2, "+"), ("Control+Shift+Tab", 10, "Tab")],
)
def test_a_chord_is_parsed_into_modifiers_and_a_key(keys: str, modifiers: int, key: str) -> None:
    assert parse_chord(keys) == (modifiers, key)


def test_a_command_has_browser_handles_in_place_of_rows() -> None:
    observation = Observation(episode=EpisodeSpec(task="t", seed=1), page=FLAT, goal=Goal("Drag it."))
    drag = Action(verb=Verb.DRAG, element=0, to=2, at=(1.0, 2.0), by=(3.0, 4.0))
    command = Command.of(drag, observation, last=True)
    first, third = int(FLAT.ref[0]), int(FLAT.ref[2])
    assert command == Command(verb=Verb.DRAG, ref=first, at=(1.0, 2.0), by=(3.0, 4.0), to=third, last=True)
    assert Command.of(Action(verb=Verb.PRESS, literal="Enter"), observation) == Command(verb=Verb.PRESS, text="Enter")
    assert Command.of(Action(verb=Verb.TYPE, element=1, start=1, end=1), observation).text == "it"


@pytest.mark.parametrize(
    ("action", "learnable"),
    [
        (Action(verb=Verb.DRAG, element=0, to=1), True),
        (Action(verb=Verb.CLICK, element=0, at=(3.0, 3.0)), True),
        (Action(verb=Verb.PRESS, element=0, literal="Enter"), True),
        (Action(verb=Verb.TYPE, element=0, literal="into a button"), False),
        (Action(verb=Verb.TYPE, element=0), False),  # words that the goal lacks
        (Action(verb=Verb.CLICK, at=(3.0, 3.0)), False),
    ],
)
def test_an_action_is_learned_only_if_it_is_a_gesture_of_the_run(action: Action, learnable: bool) -> None:
    episode = trajectory("Click Ok.", [FLAT, FLAT], [CLICK, action])
    assert "step 1 is " in episode.unlearnable(BASIC)
    assert (episode.unlearnable() == "") is learnable
    trajectory("Click Ok.", [FLAT, FLAT], [CLICK, CLICK]).choices(BASIC)


SEEDS = st.tuples(st.sampled_from(Purpose), st.integers(0, (1 << 16) - 1), st.integers(0, (1 << 32) - 1))


@given(SEEDS, SEEDS)
def test_page_seeds_are_distinct_for_distinct_purpose_run_seed_and_index(
    one: tuple[Purpose, int, int], two: tuple[Purpose, int, int]
) -> None:
    assert (page_seed(*one) == page_seed(*two)) == (one == two)
    assert 0 <= page_seed(*one) < 1 << 53


@pytest.mark.parametrize(("run_seed", "index"), [(-1, 0), (1 << 16, 0), (0, -1), (0, 1 << 32)])
def test_a_run_seed_or_index_that_does_not_fit_is_refused(run_seed: int, index: int) -> None:
    with pytest.raises(ValueError, match="out of range"):
        page_seed(Purpose.TRAIN, run_seed, index)


def test_only_the_full_reward_is_a_success() -> None:
    assert Outcome(raw_reward=1.0, ended=True).success
    assert not Outcome(raw_reward=0.999, ended=True).success


def test_weights_with_a_wrong_checksum_are_refused() -> None:
    sealed = Weights.with_digest(3, b"abc")
    sealed.check()
    with pytest.raises(ValueError, match="version 3 are corrupt"):
        replace(sealed, blob=b"abd").check()


def test_the_text_of_a_sample_element_may_contain_a_colon() -> None:
    assert page("button:Ok: really").text == ("Ok: really",)


def test_pages_are_equal_if_all_their_columns_are() -> None:
    one, other = page("Ok", "No"), page("Ok", "No")
    assert one == other
    for changes in ({"text": ("Ok", "Yes")}, {"focused": np.array([True, False])}, {"box": one.box + 1}):
        assert one != replace(other, **changes)
    assert one != "Ok"


def test_held_out_goals_have_the_wanted_fraction_and_ignore_case_and_punctuation() -> None:
    goals = [Goal(f'Click on the "word{number}" button.') for number in range(2_000)]
    held = [is_held_out(goal, 0.25) for goal in goals]
    assert 0.2 < np.mean(held) < 0.3
    assert held == [is_held_out(Goal(goal.utterance.replace("word", "WORD")), 0.25) for goal in goals]
    assert held == [is_held_out(Goal(goal.utterance.replace('" button', '." button')), 0.25) for goal in goals]
    assert not any(is_held_out(goal, 0.0) for goal in goals)
