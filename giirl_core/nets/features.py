"""The input features of the nets: one page under one goal as arrays, computed by vectorised code.

Strings are tokenised once and cached. At each step only arrays of word hashes are compared.
"""

from __future__ import annotations

import functools
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.language import PADDING, Vectors
from giirl_core.types import TOKEN, Goal, Page

WORDS = 8  # words of an element that the nets read: the first ones of its text, then of its value
TAGS = 128  # hash buckets of tag names
CLASSES = 64  # hash buckets of class names, 0 for none
CLASS_SLOTS = 3  # class names of an element that the nets read
WIDTH_PX, HEIGHT_PX = 160.0, 210.0  # of a MiniWoB page

# Columns of Features.element_ids.
ELEMENT_WORDS, TAG, CLASS = slice(0, WORDS), WORDS, slice(WORDS + 1, WORDS + 1 + CLASS_SLOTS)
CLICKABLE, TYPABLE = WORDS + 1 + CLASS_SLOTS, WORDS + 2 + CLASS_SLOTS
ELEMENT_IDS = WORDS + 3 + CLASS_SLOTS
# Columns of Features.element_flags: 0-3 left, top, width and height as fractions of a page; 4 focused; 5 tampered;
# 6 leaf; 7 typable; 8 has text; 9 has a value; 10 the goal contains the whole text, 11 between quotes, 12 in any case;
# 13 fraction of its words that are in the goal; 14 the goal contains the whole value, 15 between quotes.
POSITION, ELEMENT_OVERLAP, ELEMENT_FLAGS = slice(0, 4), slice(10, 16), 16
# Columns of Features.token_ids, and of Features.token_flags: 0 a double quote; 1 punctuation; 2 capitalised;
# 3 on the page; 4 in the value of an element; 5 between quotes.
WORD, OPEN, TOKEN_IDS = 0, 1, 2
TOKEN_OVERLAP, TOKEN_FLAGS = slice(3, 5), 6
MATCH_KINDS = 3  # words of the goal that are: the whole text of an element, any of its words, its whole value

Ids = NDArray[np.int32]
Floats = NDArray[np.float32]
Hashes = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """One page under one goal: L goal tokens, E elements, and K matches between them."""

    token_ids: Ids  # [L, TOKEN_IDS] row of the word vectors; 1 if the word is open: quoted or on the page
    token_flags: Floats  # [L, TOKEN_FLAGS]
    element_ids: Ids  # [E, ELEMENT_IDS] rows of the word vectors, tag, classes, clickable, typable
    element_flags: Floats  # [E, ELEMENT_FLAGS]
    match_ids: Ids  # [K, 3] element, kind, token
    match_weights: Floats  # [K] the weights of one element and kind sum to 1


@dataclass(frozen=True, slots=True)
class _Text:
    """The W words of the text or value of an element."""

    rows: Ids  # [WORDS] rows of the word vectors, PADDING after the last word
    exact: tuple[str, ...]  # [W] words as written
    folded: tuple[str, ...]  # [W] words in lower case
    hashes: Hashes  # [WORDS] of the first words in lower case, 0 after the last word


@dataclass(frozen=True, slots=True)
class _GoalText:
    """The L tokens of a goal."""

    rows: Ids  # [L] rows of the word vectors
    exact: tuple[str, ...]  # [L] tokens as written
    folded: tuple[str, ...]  # [L] tokens in lower case
    hashes: Hashes  # [L] of the tokens in lower case
    distinct: NDArray[np.int64]  # index of the first occurrence of each distinct token in lower case
    quoted: NDArray[np.bool_]  # [L] True between a pair of double quotes
    flags: Floats  # [L, TOKEN_FLAGS] with the overlap columns 0


@functools.lru_cache(maxsize=1 << 16)
def _read_text(text: str, vectors: Vectors) -> _Text:
    words = tuple(TOKEN.findall(text))
    folded = tuple(word.lower() for word in words)
    rows = np.full(WORDS, PADDING, dtype=np.int32)
    rows[: len(words)] = [vectors.row(word) for word in words[:WORDS]]
    hashes = np.zeros(WORDS, dtype=np.int64)
    hashes[: len(words)] = _hashes(folded[:WORDS])
    return _Text(rows=rows, exact=words, folded=folded, hashes=hashes)


@functools.lru_cache(maxsize=1 << 12)
def _read_goal(goal: Goal, vectors: Vectors) -> _GoalText:
    tokens = goal.tokens
    quote = np.array([token == '"' for token in tokens])
    quoted = (np.cumsum(quote) % 2 == 1) & ~quote
    flags = np.zeros((len(tokens), TOKEN_FLAGS), dtype=np.float32)
    flags[:, 0], flags[:, 5] = quote, quoted
    flags[:, 1] = [not token.isalnum() for token in tokens]
    flags[:, 2] = [token[:1].isupper() for token in tokens]
    folded = tuple(token.lower() for token in tokens)
    hashes = _hashes(folded)
    return _GoalText(
        rows=np.array([vectors.row(token) for token in tokens], dtype=np.int32),
        exact=tokens,
        folded=folded,
        hashes=hashes,
        distinct=np.unique(hashes, return_index=True)[1],
        quoted=quoted,
        flags=flags,
    )


@functools.lru_cache(maxsize=1 << 12)
def _tag_id(tag: str) -> int:
    return zlib.crc32(tag.encode()) % TAGS


@functools.lru_cache(maxsize=1 << 14)
def _class_ids(classes: str) -> tuple[int, ...]:
    ids = [1 + zlib.crc32(name.encode()) % (CLASSES - 1) for name in classes.split()[:CLASS_SLOTS]]
    return (*ids, *[0] * (CLASS_SLOTS - len(ids)))


def _hashes(words: Sequence[str]) -> Hashes:
    """Python's own 64-bit hashes, which are only valid within this process."""
    return np.array([hash(word) for word in words], dtype=np.int64)


def featurise(page: Page, goal: Goal, vectors: Vectors) -> Features:
    """The features of a page under a goal. Overlap is case-sensitive, except where words are `folded`."""
    goal_text, count, length = _read_goal(goal, vectors), len(page), len(goal.tokens)
    texts = [_read_text(text, vectors) for text in page.text]
    values = {e: _read_text(value, vectors) for e, value in enumerate(page.value) if value}
    ids = np.zeros((count, ELEMENT_IDS), dtype=np.int32)
    folded = np.zeros((count, WORDS), dtype=np.int64)  # hashes of the words of each element, 0 after the last one
    if count:
        ids[:, ELEMENT_WORDS] = np.concatenate([text.rows for text in texts]).reshape(count, WORDS)
        ids[:, TAG] = [_tag_id(tag) for tag in page.tag]
        ids[:, CLASS] = [_class_ids(classes) for classes in page.classes]
        folded = np.concatenate([text.hashes for text in texts]).reshape(count, WORDS)
    for e, value in values.items():
        used = min(len(texts[e].exact), WORDS)
        ids[e, used:WORDS], folded[e, used:] = value.rows[: WORDS - used], value.hashes[: WORDS - used]
    leaf, typable = page.leaf, page.typable
    ids[:, CLICKABLE], ids[:, TYPABLE] = leaf, typable
    matches = np.zeros((count, MATCH_KINDS, length), dtype=np.bool_)
    matches[:, 1] = (folded[:, :, None] == goal_text.hashes).any(axis=1)
    flags = np.zeros((count, ELEMENT_FLAGS), dtype=np.float32)
    flags[:, POSITION] = page.box / (WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX)
    flags[:, 4], flags[:, 5], flags[:, 6], flags[:, 7] = page.focused, page.tampered, leaf, typable
    flags[:, 8] = [len(text.exact) > 0 for text in texts]
    for e in np.flatnonzero(matches[:, 1].any(axis=1)).tolist():
        for start in _occurrences(goal_text.exact, texts[e].exact):
            matches[e, 0, start : start + len(texts[e].exact)] = True
        flags[e, 12] = any(True for _ in _occurrences(goal_text.folded, texts[e].folded))
        flags[e, 13] = matches[e, 1, goal_text.distinct].sum() / len({*folded[e].tolist()} - {0})
    for e, value in values.items():
        flags[e, 9] = len(value.exact) > 0
        for start in _occurrences(goal_text.exact, value.exact):
            matches[e, 2, start : start + len(value.exact)] = True
    flags[:, 10], flags[:, 11] = matches[:, 0].any(axis=1), (matches[:, 0] & goal_text.quoted).any(axis=1)
    flags[:, 14], flags[:, 15] = matches[:, 2].any(axis=1), (matches[:, 2] & goal_text.quoted).any(axis=1)
    token_flags, on_page = goal_text.flags.copy(), matches[:, 1].any(axis=0)
    token_flags[:, 3], token_flags[:, 4] = on_page, matches[:, 2].any(axis=0)
    elements, kinds, tokens = np.nonzero(matches)
    return Features(
        token_ids=np.stack([goal_text.rows, goal_text.quoted | on_page], axis=1, dtype=np.int32),
        token_flags=token_flags,
        element_ids=ids,
        element_flags=flags,
        match_ids=np.stack([elements, kinds, tokens], axis=1).astype(np.int32),
        match_weights=(1.0 / matches.sum(axis=2)[elements, kinds]).astype(np.float32),
    )


def _occurrences(tokens: tuple[str, ...], words: tuple[str, ...]) -> Iterator[int]:
    """The indices at which the complete sequence `words` starts in `tokens`."""
    if words and words[0] in tokens:
        for start in range(tokens.index(words[0]), len(tokens) - len(words) + 1):
            if tokens[start : start + len(words)] == words:
                yield start
