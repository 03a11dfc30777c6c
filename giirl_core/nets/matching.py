"""Matches between the elements of a page and the words of a goal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
from giirl_core.nets.page_features import PageFeatures, Words
from giirl_core.nets.reading import Floats, GoalText, Text, occurrences
from giirl_core.nets.relations import NONE

MIN_COSINE = 0.25  # of the most similar word of the page
SIMILAR_COSINE = 0.5  # of similar words

Matches = NDArray[np.bool_]  # [E, MATCH_KINDS, L]


def match(read: PageFeatures, goal: GoalText, flags: Floats) -> Matches:
    """[E, MATCH_KINDS, L] True where a word of the goal matches an element. Sets the columns of `flags` on texts.

    Runs are case-sensitive, single words are not.
    """
    matches = np.zeros((len(read.texts), MATCH_KINDS, len(goal.exact)), dtype=np.bool_)
    if not len(matches):
        return matches
    _match_words(matches[:, TEXT_WORD], read.hashes, goal)
    _match_words(matches[:, KIND_WORD], read.kinds, goal)
    rows = np.flatnonzero(matches[:, TEXT_WORD].any(axis=1))
    for e in rows.tolist():
        distinct = {*read.word_hashes[e].tolist()} - {0}
        flags[e, WORD_FRACTION] = matches[e, TEXT_WORD, goal.distinct].sum() / len(distinct)
        _match_run(matches[e, TEXT_RUN], goal, read.texts[e])
        flags[e, TEXT_FOLDED] = any(True for _ in occurrences(goal.folded, read.texts[e].folded))
    for e, text in read.values.items():
        _match_run(matches[e, VALUE_RUN], goal, text)
    for e, text in read.attributes.items():
        _match_run(matches[e, ATTRIBUTE_RUN], goal, text)
    if goal.affixes:
        for e, first, last in read.ends:
            flags[e, PREFIX], flags[e, SUFFIX] = first.startswith(goal.affixes), last.endswith(goal.affixes[-1])
    _match_similar(matches, read, goal, flags)
    _match_labels(matches, read.structure.label, flags)
    _match_groups(matches, read.structure.group)
    return matches


def _match_words(matches: NDArray[np.bool_], words: Words, goal: GoalText) -> None:
    """Set matches [E, L] where an element has a word of the goal, in any case."""
    if len(words.rows):
        matches[words.rows] = np.logical_or.reduceat(words.words[:, None] == goal.hashes, words.starts, axis=0)


def _match_run(matches: NDArray[np.bool_], goal: GoalText, text: Text) -> None:
    """Set matches [L] where the goal contains a whole text."""
    for start in occurrences(goal.exact, text.exact):
        matches[start : start + len(text.exact)] = True


def _match_similar(matches: Matches, read: PageFeatures, goal: GoalText, flags: Floats) -> None:
    """Match goal words that are not on the page with similar words, by the cosine of their word vectors."""
    cosine = np.zeros((len(matches), len(goal.exact)), dtype=np.float32)
    if len(read.vectors.rows):
        table = np.maximum(read.units @ goal.units.T, 0.0)
        cosine[read.vectors.rows] = np.maximum.reduceat(table[read.vectors.words], read.vectors.starts, axis=0)
    flags[:, SIMILARITY] = cosine.max(axis=1)
    absent = ~matches[:, TEXT_WORD].any(axis=0)  # [L]
    best = cosine.max(axis=0)
    candidates = cosine * absent
    mutual = (candidates == candidates.max(axis=1, keepdims=True)) & (cosine == best)
    matches[:, MOST_SIMILAR] = mutual & (best > MIN_COSINE) & absent
    matches[:, SIMILAR] = (cosine >= SIMILAR_COSINE) & absent


def _match_labels(matches: Matches, label: NDArray[np.int64], flags: Floats) -> None:
    """Match fields with the words that match their labels."""
    fields = np.flatnonzero(label != NONE)
    if not len(fields):
        return
    labels = label[fields]
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
