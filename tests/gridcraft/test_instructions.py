"""Instructions: every one means one pair only, and says it in words that name its colours."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from giirl_core.types import Goal
from gridcraft.instructions import (
    FORMS,
    SYNONYMS,
    Pair,
    draw_sentence,
    ordered_pairs,
    plain_sentence,
    rename,
    sentences,
)
from gridcraft.layouts import COLOURS
from learner.grid.goal_features import BagOfWords


def test_the_plain_sentence_is_the_one_of_the_thesis() -> None:
    assert plain_sentence(Pair("red", "blue")) == "Go to Red. Avoid Blue."
    assert sentences(Pair("green", "blue"))[0] == plain_sentence(Pair("green", "blue"))


def test_no_sentence_means_two_pairs_and_none_is_said_twice() -> None:
    assert len(ordered_pairs()) == 12
    count = Counter(sentence for pair in ordered_pairs() for sentence in sentences(pair))
    assert max(count.values()) == 1
    assert len(count) == 12 * len(FORMS) * 16


def test_no_word_names_two_colours_and_every_colour_has_several() -> None:
    words = [word for colour in COLOURS for word in SYNONYMS[colour]]
    assert len(set(words)) == len(words)
    assert all(colour == SYNONYMS[colour][0] and len(SYNONYMS[colour]) >= 3 for colour in COLOURS)


@pytest.mark.parametrize("pair", ordered_pairs(), ids=str)
def test_a_sentence_names_its_two_colours_and_no_other(pair: Pair) -> None:
    owner = {word: colour for colour, words in SYNONYMS.items() for word in words}
    for sentence in sentences(pair):
        named = [owner[token.lower()] for token in Goal(sentence).tokens if token.lower() in owner]
        assert sorted(named) == sorted([pair.goal, pair.avoid])


def test_drawn_sentences_repeat_with_their_seed_and_come_in_both_orders() -> None:
    pair = Pair("red", "yellow")
    drawn, again = ([draw_sentence(pair, rng) for _ in range(200)] for rng in map(np.random.default_rng, (3, 3)))
    assert drawn == again
    assert set(drawn) <= set(sentences(pair))
    goal_first = [min(s.lower().find(w) for w in SYNONYMS["red"] if w in s.lower()) for s in drawn]
    avoid_first = [min(s.lower().find(w) for w in SYNONYMS["yellow"] if w in s.lower()) for s in drawn]
    assert {g < a for g, a in zip(goal_first, avoid_first, strict=True)} == {True, False}


def test_a_plain_bag_of_words_cannot_tell_a_sentence_from_its_swap_and_neighbouring_pairs_can() -> None:
    said, swapped = plain_sentence(Pair("red", "blue")), plain_sentence(Pair("blue", "red"))
    words, neighbours = BagOfWords([said, swapped]), BagOfWords([said, swapped], order=2)
    assert (words(said) == words(swapped)).all()
    assert (neighbours(said) != neighbours(swapped)).any()


def test_a_pair_of_one_colour_or_of_an_unknown_one_is_refused() -> None:
    with pytest.raises(ValueError, match="wanted two colours"):
        Pair("red", "red")
    with pytest.raises(ValueError, match="no colour 'Red'"):
        Pair("Red", "blue")


def test_renaming_exchanges_every_word_for_a_colour_and_keeps_all_others() -> None:
    names = {"red": "blue", "blue": "red", "green": "green"}
    assert rename("Go to Red. Avoid Blue.", names) == "Go to Blue. Avoid Red."
    assert rename("Keep off navy and head for jade.", names) == "Keep off scarlet and head for jade."
    for pair in ordered_pairs():
        other = Pair(names.get(pair.goal, pair.goal), names.get(pair.avoid, pair.avoid))
        assert {rename(sentence, names) for sentence in sentences(pair)} == set(sentences(other))
