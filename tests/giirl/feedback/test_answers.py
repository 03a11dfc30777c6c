"""Answers about episodes: what becomes a demonstration, what a negative, and their files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl_core.types import DEMONSTRATION, UNSCORED, Goal
from giirl_core.wire.answers import Answer, encode_answer, read_answer, write_answer
from giirl_core.wire.messages import WireError
from tests.giirl.feedback.examples import clicking, typing

EPISODE = clicking(7, steps=3).trajectory
TYPED = typing(7).trajectory


def test_an_episode_that_is_right_is_a_demonstration_and_no_negative() -> None:
    (one,) = Answer(episode=EPISODE).demonstrations
    assert (one.goal, one.actions, one.policy_version, one.reward_version) == (
        EPISODE.goal,
        EPISODE.actions,
        DEMONSTRATION,
        UNSCORED,
    )
    assert list(Answer(episode=EPISODE).wrong_steps) == []


def test_a_wrong_episode_is_a_negative_from_the_marked_step_on() -> None:
    answer = Answer(episode=EPISODE, wrong_from=1)
    assert list(answer.wrong_steps) == [1, 2]
    assert answer.demonstrations == []


def test_a_relabelled_episode_types_the_same_words_of_the_other_instruction() -> None:
    other = Goal('Please submit the form with "Ada" in it.')
    (one,) = Answer(episode=TYPED, wrong_from=0, right_for=other).demonstrations
    assert one.goal == other
    assert one.actions[0].text(other) == "Ada"
    assert one.actions[0].start != TYPED.actions[0].start


def test_an_instruction_without_the_words_that_were_typed_is_refused() -> None:
    with pytest.raises(ValueError, match="step 1 types “Ada”: wanted an instruction with these words"):
        Answer(episode=TYPED, wrong_from=0, right_for=Goal("Enter Bertram."))


def test_the_way_that_a_person_shows_is_a_demonstration() -> None:
    (one,) = Answer(episode=EPISODE, wrong_from=2, shown=clicking(7, steps=1).trajectory).demonstrations
    assert len(one) == 1


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"wrong_from": 3}, "step 3 is marked as wrong, the episode has 3 steps"),
        ({"wrong_from": -2}, "step -2 is marked"),
        ({"right_for": Goal("Ok.")}, "an episode that is right needs neither"),
        ({"wrong_from": 0, "shown": TYPED}, "the way shown is of 'enter-text', the episode of 'click-button'"),
    ],
)
def test_a_contradiction_is_no_answer(fields: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Answer(episode=EPISODE, **fields)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "answer",
    [
        Answer(episode=EPISODE),
        Answer(episode=EPISODE, wrong_from=1, right_for=Goal("Cancel \ud800 it.")),
        Answer(episode=EPISODE, wrong_from=2, shown=clicking(7, steps=1).trajectory),
    ],
    ids=["right", "relabelled", "shown"],
)
def test_a_file_gives_back_the_answer(answer: Answer, tmp_path: Path) -> None:
    found = read_answer(write_answer(tmp_path, answer))
    assert (found.wrong_from, found.right_for) == (answer.wrong_from, answer.right_for)
    assert encode_answer(found) == encode_answer(answer)
    assert [len(one) for one in found.demonstrations] == [len(one) for one in answer.demonstrations]


def test_a_page_that_is_answered_twice_has_one_answer_the_last(tmp_path: Path) -> None:
    write_answer(tmp_path, Answer(episode=EPISODE))
    path = write_answer(tmp_path, Answer(episode=EPISODE, wrong_from=1))
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    assert read_answer(path).wrong_from == 1


def test_tasks_whose_names_are_paths_have_files_of_their_own() -> None:
    names = [Answer(episode=replace(EPISODE, task=task)).file_name for task in ("a/b.toml", "a-b.toml", "a%2Fb.toml")]
    assert len(set(names)) == 3
    assert not any("/" in name for name in names)


MESSAGE = encode_answer(Answer(episode=EPISODE, wrong_from=1))


@given(at=st.integers(0, len(MESSAGE) - 1), bit=st.integers(0, 7), cut=st.integers(0, len(MESSAGE)))
def test_a_damaged_file_is_a_value_error_with_its_name_and_nothing_else(
    at: int, bit: int, cut: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    damaged = bytearray(MESSAGE)
    damaged[at] ^= 1 << bit
    path = tmp_path_factory.mktemp("damaged") / "one.answer"
    for content in (bytes(damaged), MESSAGE[:cut] if cut < len(MESSAGE) else b""):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="is no answer, or it is damaged") as raised:
            read_answer(path)
        assert not isinstance(raised.value, WireError)
        assert str(path) in str(raised.value)
