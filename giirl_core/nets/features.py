"""The input features of the nets: one page under one goal as arrays, computed by vectorised code."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.colours import COLOURS
from giirl_core.nets.language import Vectors
from giirl_core.nets.layout import (
    ACTED_COUNT,
    ACTED_EQUAL,
    ACTED_SIGN,
    CALENDAR,
    COMPARED,
    COUNTS_FITTING,
    DISTANCE,
    DONE,
    ELEMENT_FLAGS,
    EQUAL,
    FITS,
    FOCUSED,
    GOAL_NUMBERS,
    GROUP_RUN,
    HAS_NUMBER,
    HAS_PEER,
    IN_VALUE,
    KIND_WORD,
    LABEL_RUN,
    LABEL_WORD,
    MATCH_KINDS,
    MATCHED,
    MATCHED_QUOTED,
    MOST_SIMILAR,
    NEXT,
    ON_PAGE,
    PAGE_FLAGS,
    PEER,
    PER_NUMBER,
    RANK_EQUAL,
    RANK_IN_GOAL,
    SIGN,
    SIMILAR,
    TAMPERED,
    TEXT_RUN,
    TEXT_WORD,
    TOKEN_MATCHES,
    VALUE_RUN,
    WANTED,
)
from giirl_core.nets.matching import Matches, match
from giirl_core.nets.page_features import PageFeatures, page_features
from giirl_core.nets.reading import Floats, GoalText, Ids, read_goal
from giirl_core.types import Goal, Page

# Matches of goal tokens, and the columns of their flags.
_TOKEN_MATCHES = np.array([TEXT_WORD, VALUE_RUN, TEXT_RUN, KIND_WORD, LABEL_WORD, GROUP_RUN, SIMILAR])
_TOKEN_COLUMNS = np.array([ON_PAGE, IN_VALUE, *range(TOKEN_MATCHES.start, TOKEN_MATCHES.stop)])
_NAMING = np.isin(np.arange(MATCH_KINDS), (TEXT_RUN, LABEL_RUN, MOST_SIMILAR))  # [MATCH_KINDS] naming an element
_PEER_MATCHES = np.array([TEXT_RUN, KIND_WORD, LABEL_RUN, GROUP_RUN])


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """One page under one goal: L goal tokens, E elements, and K matches between them. See `layout` for the columns."""

    token_ids: Ids  # [L, TOKEN_IDS] row of the word vectors; 1 if it is open: quoted, on the page or MOST_SIMILAR
    token_flags: Floats  # [L, TOKEN_FLAGS]
    element_ids: Ids  # [E, ELEMENT_IDS] rows of the word vectors, tag, classes, clickable, typable
    element_flags: Floats  # [E, ELEMENT_FLAGS]
    group: NDArray[np.int64]  # [E] row of the nearest repeated ancestor, e.g. a row of a table; its own row if none
    relations: NDArray[np.uint8]  # [E, E] relation of the element in the column to that in the row
    match_ids: Ids  # [K, 3] element, kind, token
    match_weights: Floats  # [K] the weights of one element and kind sum to 1


def featurise(page: Page, goal: Goal, vectors: Vectors) -> Features:
    """The features of a page under a goal."""
    text, read, count = read_goal(goal, vectors), page_features(page, vectors), len(page)
    flags = np.zeros((count, ELEMENT_FLAGS), dtype=np.float32)
    flags[:, :PAGE_FLAGS] = read.flags
    flags[:, FOCUSED], flags[:, TAMPERED] = page.focused, page.tampered
    matches = match(read, text, flags, vectors)
    rows, tokens = np.divmod(matches.ravel().nonzero()[0], len(text.exact))  # nonzero is slow in more dimensions
    elements, kinds = np.divmod(rows, MATCH_KINDS)
    match_counts = np.bincount(rows, minlength=count * MATCH_KINDS)
    flags[:, MATCHED] = match_counts.reshape(count, MATCH_KINDS) > 0
    quoted = text.quoted[tokens]
    flags[elements[quoted], MATCHED_QUOTED.start + kinds[quoted]] = 1.0
    acted = page.tampered & read.structure.leaf
    _compare_numbers(flags, acted, read, text)
    _compare_month(flags, read, text)
    _compare_drawings(flags, page, read, text)
    _mark_peers(flags, acted, read, matches)
    by_kind = np.zeros((MATCH_KINDS, len(text.exact)), dtype=np.bool_)
    by_kind[kinds, tokens] = True
    token_flags = text.flags.copy()
    token_flags[:, _TOKEN_COLUMNS] = by_kind[_TOKEN_MATCHES].T
    token_flags[tokens[acted[elements] & _NAMING[kinds]], DONE] = 1.0
    if len(text.counted):
        token_flags[text.counted, NEXT] = np.isin(text.counts - 1, read.number)
    is_open = text.quoted | by_kind[TEXT_WORD] | by_kind[MOST_SIMILAR]
    return Features(
        token_ids=np.array((text.rows, is_open), dtype=np.int32).T,
        token_flags=token_flags,
        element_ids=read.ids,
        element_flags=flags,
        group=read.structure.own_group,
        relations=read.structure.relations,
        match_ids=np.array((elements, kinds, tokens), dtype=np.int32).T,
        match_weights=(1.0 / match_counts[rows]).astype(np.float32),
    )


def _compare_numbers(flags: Floats, leaves: NDArray[np.bool_], read: PageFeatures, goal: GoalText) -> None:
    """Compare the numbers of the goal with those of elements, their ranks, and the number of `leaves` [E] acted on."""
    acted = int(leaves.sum())
    flags[:, ACTED_COUNT] = np.log1p(acted)
    count = len(goal.numbers)
    if not count:
        return
    numbers, rank = goal.numbers, read.structure.rank[:, None]
    flags[:, RANK_IN_GOAL] = (rank == numbers).any(axis=1)
    compared = np.zeros((len(flags), GOAL_NUMBERS, PER_NUMBER), dtype=np.float32)
    found = np.flatnonzero(read.flags[:, HAS_NUMBER])
    if len(found):
        difference = numbers - read.number[found, None]
        sign = np.sign(difference)
        compared[found, :count, EQUAL], compared[found, :count, SIGN] = difference == 0, sign
        compared[found, :count, DISTANCE] = sign * np.log1p(np.abs(difference)) / 4
    compared[:, :count, RANK_EQUAL] = (numbers - rank) % read.structure.alike[:, None] == 0
    compared[:, :count, ACTED_EQUAL], compared[:, :count, ACTED_SIGN] = acted == numbers, np.sign(numbers - acted)
    compared[:, :count, WANTED] = np.clip(numbers, -20, 40) / 10
    flags[:, COMPARED:] = compared.reshape(len(flags), GOAL_NUMBERS * PER_NUMBER)


def _compare_month(flags: Floats, read: PageFeatures, goal: GoalText) -> None:
    """Compare the month of the goal with that of a calendar. All elements of the page have the same flags."""
    if goal.month is None or read.month is None:
        return
    year, month = read.month
    shown = (goal.month[0] if year is None else year, month)
    flags[:, CALENDAR] = (True, shown == goal.month, goal.month > shown, goal.month < shown)


def _compare_drawings(flags: Floats, page: Page, read: PageFeatures, goal: GoalText) -> None:
    """Mark the drawings that the goal describes, and the elements whose text is their number.

    Marks nothing if the goal names a colour and the page has none, as in the human recordings.
    """
    if not read.drawings or (goal.described is None and not goal.characters):
        return
    wanted = goal.described or frozenset()
    if wanted & COLOURS and not any(page.colour[e] for e in read.drawings):
        return
    drawings = read.drawings.items()
    fits = [e for e, words in drawings if wanted <= words and (not goal.characters or page.text[e] in goal.characters)]
    flags[fits, FITS] = 1.0
    flags[:, COUNTS_FITTING] = [element.text.number == len(fits) for element in read.elements]
    flags[list(read.drawings), COUNTS_FITTING] = 0.0


def _mark_peers(flags: Floats, acted: NDArray[np.bool_], read: PageFeatures, matches: Matches) -> None:
    """Mark leaves that have the tag, first class and matches of a leaf that was `acted` on, and were not acted on."""
    if not acted.any():
        return
    matched: NDArray[np.bool_] = np.any(matches[:, _PEER_MATCHES], axis=1)  # [E, L]
    kinds = read.structure.kinds

    def key(e: int) -> tuple[tuple[str, str], bytes]:
        return kinds[e], matched[e].tobytes()

    keys = {key(e) for e in np.flatnonzero(acted & matched.any(axis=1)).tolist()}
    others = np.flatnonzero(read.structure.leaf & ~acted).tolist() if keys else ()
    peers = [e for e in others if key(e) in keys]
    flags[peers, PEER] = 1.0
    flags[:, HAS_PEER] = len(peers) > 0
