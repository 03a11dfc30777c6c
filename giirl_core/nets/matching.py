"""Matches between the elements of a page and the words of a goal."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.language import Vectors
from giirl_core.nets.layout import (
    ATTRIBUTE_RUN,
    GROUP_RUN,
    KIND_WORD,
    LABEL_RUN,
    LABEL_SIMILARITY,
    LABEL_WORD,
    MATCH_KINDS,
    MOST_SIMILAR,
    PREFIX,
    SIMILAR,
    SIMILARITY,
    SUFFIX,
    TEXT_FOLDED,
    TEXT_RUN,
    TEXT_WORD,
    VALUE_RUN,
    WORD_FRACTION,
)
from giirl_core.nets.page_features import PageFeatures
from giirl_core.nets.reading import Floats, GoalText, Text, occurrences
from giirl_core.nets.relations import NONE, Structure

MIN_LIKENESS = 0.5  # of similar words

Matches = NDArray[np.bool_]  # [E, MATCH_KINDS, L]


def match(read: PageFeatures, goal: GoalText, flags: Floats, vectors: Vectors) -> Matches:
    """[E, MATCH_KINDS, L] True where a word of the goal matches an element. Sets the columns of `flags` on texts.

    Runs are case-sensitive, single words are not.
    """
    length = len(goal.exact)
    matches = np.zeros((len(read.elements), MATCH_KINDS, length), dtype=np.bool_)
    found: list[int] = []  # indices of the flat array
    for e, element in enumerate(read.elements):
        at = e * MATCH_KINDS
        if not goal.words.isdisjoint(element.words):
            distinct = {*element.words}
            common = distinct & goal.words
            found += [(at + TEXT_WORD) * length + index for word in common for index in goal.folded_places[word]]
            found += _run(goal, element.text, (at + TEXT_RUN) * length)
            flags[e, WORD_FRACTION] = len(common) / len(distinct)
            folded = element.text.folded
            flags[e, TEXT_FOLDED] = any(True for _ in occurrences(goal.folded, goal.folded_places, folded))
        if not goal.words.isdisjoint(element.kind.words):
            named = goal.words.intersection(element.kind.words)
            found += [(at + KIND_WORD) * length + index for word in named for index in goal.folded_places[word]]
        if element.value is not None:
            found += _run(goal, element.value, (at + VALUE_RUN) * length)
        if element.attributes is not None:
            found += _run(goal, element.attributes, (at + ATTRIBUTE_RUN) * length)
    matches.ravel()[found] = True
    if goal.affixes:
        _mark_affixes(read, goal, flags)
    _match_similar(matches, read, goal, flags, vectors)
    _match_labels(matches, read.structure, flags)
    _match_groups(matches, read.structure.group)
    return matches


def _run(goal: GoalText, text: Text, first: int) -> list[int]:
    """`first` + the indices of the words of the goal that are part of a whole text."""
    starts = occurrences(goal.exact, goal.places, text.exact)
    return [first + index for start in starts for index in range(start, start + len(text.exact))]


def _mark_affixes(read: PageFeatures, goal: GoalText, flags: Floats) -> None:
    for e, element in enumerate(read.elements):
        words = element.text.folded or (() if element.value is None else element.value.folded)
        if words:
            flags[e, PREFIX], flags[e, SUFFIX] = words[0].startswith(goal.affixes), words[-1].endswith(goal.affixes[-1])


def _match_similar(matches: Matches, read: PageFeatures, goal: GoalText, flags: Floats, vectors: Vectors) -> None:
    """Match goal words that are not on the page with words of like meaning.

    How like two words are is the cosine of their vectors, from 0, plus what WordNet says of their meanings. The
    likeliest match is an element's only one and its word's only one (but for elements that are equally like), then the
    likeliest of those that are left, and so on. An element whose whole text, value or label is in the goal needs none.
    """
    elements = read.with_words
    if not len(elements):
        return
    absent = np.flatnonzero(~matches[:, TEXT_WORD].any(axis=0) & goal.units.any(axis=1))
    likeness = np.maximum(read.units @ goal.units[absent].T, 0.0)
    likeness += _kinship(read.rows, tuple(goal.rows[absent].tolist()), vectors)
    found = np.maximum.reduceat(likeness[read.unit], read.first_unit, axis=0)  # [R, absent]
    matches[elements[:, None], SIMILAR, absent] = found > MIN_LIKENESS
    named: NDArray[np.bool_] = (flags[:, TEXT_FOLDED] > 0) | np.any(matches[:, VALUE_RUN], axis=1)
    fields = read.structure.labelled
    named[fields] |= named[read.structure.label[fields]]
    open_ = found * ~named[elements, None]
    while open_.size and (best := open_.max()) > MIN_LIKENESS:
        word = int(open_.max(axis=0).argmax())
        equal = open_[:, word] == best
        matches[elements[equal], MOST_SIMILAR, absent[word]] = True
        flags[elements[equal], SIMILARITY] = best
        open_[equal] = open_[:, word] = 0.0


@functools.lru_cache(maxsize=1 << 10)
def _kinship(rows: tuple[int, ...], others: tuple[int, ...], vectors: Vectors) -> Floats:
    """[rows, others] how near words are by their meanings. It must not be changed."""
    table = [[vectors.kinship(row, other) for other in others] for row in rows]
    return np.array(table, dtype=np.float32).reshape(len(rows), len(others))


def _match_labels(matches: Matches, structure: Structure, flags: Floats) -> None:
    """Match fields with the words that match their labels."""
    fields = structure.labelled
    if not len(fields):
        return
    labels = structure.label[fields]
    matches[fields, LABEL_RUN], matches[fields, LABEL_WORD] = matches[labels, TEXT_RUN], matches[labels, TEXT_WORD]
    matches[fields, SIMILAR] |= matches[labels, SIMILAR]
    matches[fields, MOST_SIMILAR] |= matches[labels, MOST_SIMILAR]
    flags[fields, LABEL_SIMILARITY] = flags[labels, SIMILARITY]


def _match_groups(matches: Matches, group: NDArray[np.int64]) -> None:
    """Match the elements of a row of a table with the whole texts of the other elements in the row."""
    found: dict[int, NDArray[np.bool_]] = {}
    texts = matches[:, TEXT_RUN]
    for e in np.flatnonzero(texts.any(axis=1) & (group != NONE)).tolist():
        at = int(group[e])
        found[at] = found[at] | texts[e] if at in found else texts[e].copy()
    for at, words in found.items():
        members = np.flatnonzero(group == at)
        matches[members, GROUP_RUN] = words & ~texts[members]
