"""Every instruction has one meaning and names exactly its two colours."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from giirl_core.types import Goal
from gridcraft.instructions import (
    SYNONYMS,
    TEMPLATES,
    ColourPair,
    ordered_pairs,
    plain_sentence,
    rename_colours,
    sample_sentence,
    sentences,
)
from gridcraft.layouts import COLOURS
from learner.grid.goal_features import BagOfWords


def test_the_plain_sentence_has_the_wording_of_the_thesis() -> None:
    assert plain_sentence(ColourPair("red", "blue")) == "Go to Red. Avoid Blue."
    assert sentences(ColourPair("green", "blue"))[0] == plain_sentence(ColourPair("green", "blue"))


def test_sentences_are_unique_across_all_pairs() -> None:
    assert len(ordered_pairs()) == 12
    count = Counter(sentence for pair in ordered_pairs() for sentence in sentences(pair))
    assert max(count.values()) == 1
    assert len(count) == 12 * len(TEMPLATES) * 16


def test_every_colour_has_several_words_and_no_word_names_two_colours() -> None:
    words = [word for colour in COLOURS for word in SYNONYMS[colour]]
    assert len(set(words)) == len(words)
    assert all(colour == SYNONYMS[colour][0] and len(SYNONYMS[colour]) >= 3 for colour in COLOURS)


@pytest.mark.parametrize("pair", ordered_pairs(), ids=str)
def test_a_sentence_names_exactly_its_two_colours(pair: ColourPair) -> None:
    owner = {word: colour for colour, words in SYNONYMS.items() for word in words}
    for sentence in sentences(pair):
        named = [owner[token.lower()] for token in Goal(sentence).tokens if token.lower() in owner]
        assert sorted(named) == sorted([pair.goal, pair.avoid])


def test_sampled_sentences_depend_on_the_seed_and_use_both_word_orders() -> None:
    pair = ColourPair("red", "yellow")
    sampled, again = ([sample_sentence(pair, rng) for _ in range(200)] for rng in map(np.random.default_rng, (3, 3)))
    assert sampled == again
    assert set(sampled) <= set(sentences(pair))
    goal_first = [min(s.lower().find(w) for w in SYNONYMS["red"] if w in s.lower()) for s in sampled]
    avoid_first = [min(s.lower().find(w) for w in SYNONYMS["yellow"] if w in s.lower()) for s in sampled]
    assert {g < a for g, a in zip(goal_first, avoid_first, strict=True)} == {True, False}


def test_bigrams_distinguish_a_sentence_from_its_goal_swap_and_single_words_do_not() -> None:
    sentence, swapped = plain_sentence(ColourPair("red", "blue")), plain_sentence(ColourPair("blue", "red"))
    words, bigrams = BagOfWords([sentence, swapped]), BagOfWords([sentence, swapped], ngram_order=2)
    assert (words(sentence) == words(swapped)).all()
    assert (bigrams(sentence) != bigrams(swapped)).any()


def test_a_pair_with_equal_or_unknown_colours_is_an_error() -> None:
    with pytest.raises(ValueError, match="wanted two colours"):
        ColourPair("red", "red")
    with pytest.raises(ValueError, match="no colour 'Red'"):
        ColourPair("Red", "blue")


def test_renaming_replaces_colour_words_and_keeps_all_other_words() -> None:
    names = {"red": "blue", "blue": "red", "green": "green"}
    assert rename_colours("Go to Red. Avoid Blue.", names) == "Go to Blue. Avoid Red."
    assert rename_colours("Keep off navy and head for jade.", names) == "Keep off scarlet and head for jade."
    for pair in ordered_pairs():
        other = ColourPair(names.get(pair.goal, pair.goal), names.get(pair.avoid, pair.avoid))
        assert {rename_colours(sentence, names) for sentence in sentences(pair)} == set(sentences(other))
