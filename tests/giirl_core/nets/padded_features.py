"""Reference implementation of batches, for tests: padded tables [B, E, ...], and plain loops for matching words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from giirl_core.nets.features import Features as FlatFeatures
from giirl_core.nets.language import PADDING, Vectors
from giirl_core.nets.layout import (
    CLASS,
    CLASS_SLOTS,
    ELEMENT_FLAGS,
    ELEMENT_KIND,
    ELEMENT_OVERLAP,
    ELEMENT_WORDS,
    KIND_WORDS,
    MATCH_KINDS,
    TAG,
    TOKEN_FLAGS,
    TOKEN_OVERLAP,
    WORD,
    WORDS,
)
from giirl_core.types import TOKEN, Goal, Page


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """One page under one goal as dense tables: L goal tokens, E elements."""

    token_words: NDArray[np.int64]  # [L] row of the word vectors
    token_flags: NDArray[np.float32]  # [L, TOKEN_FLAGS]
    element_words: NDArray[np.int64]  # [E, WORDS] row of the word vectors, 0 after the last word
    element_kind: NDArray[np.int64]  # [E, KIND_WORDS] row of the word vectors, 0 after the last word
    element_tag: NDArray[np.int64]  # [E]
    element_classes: NDArray[np.int64]  # [E, CLASS_SLOTS]
    element_flags: NDArray[np.float32]  # [E, ELEMENT_FLAGS]
    same_group: NDArray[np.bool_]  # [E, E]
    relations: NDArray[np.int64]  # [E, E]
    matches: NDArray[np.float32]  # [MATCH_KINDS, E, L] the sum over L is 1, or 0 without a match
    clickable: NDArray[np.bool_]  # [E]
    typable: NDArray[np.bool_]  # [E]


def dense(features: FlatFeatures, page: Page) -> Features:
    """The features of a page as dense tables."""
    ids = features.element_ids.astype(np.int64)
    matches = np.zeros((MATCH_KINDS, len(page), len(features.token_ids)), dtype=np.float32)
    for (element, kind, token), weight in zip(features.match_ids.tolist(), features.match_weights, strict=True):
        matches[kind, element, token] = weight
    return Features(
        token_words=features.token_ids[:, WORD].astype(np.int64),
        token_flags=features.token_flags,
        element_words=ids[:, ELEMENT_WORDS],
        element_kind=ids[:, ELEMENT_KIND],
        element_tag=ids[:, TAG],
        element_classes=ids[:, CLASS],
        element_flags=features.element_flags,
        same_group=features.group[:, None] == features.group,
        relations=features.relations.astype(np.int64),
        matches=matches,
        clickable=page.leaf,
        typable=page.typable,
    )


def word_rows(page: Page, vectors: Vectors) -> NDArray[np.int64]:
    """[E, WORDS] the rows of the first words of the text, then the value, of each element."""
    words = np.full((len(page), WORDS), PADDING, dtype=np.int64)
    for e in range(len(page)):
        read = [*_words(page.text[e]), *_words(page.value[e])][:WORDS]
        words[e, : len(read)] = [vectors.row(word) for word in read]
    return words


def text_matches(page: Page, goal: Goal) -> NDArray[np.float32]:
    """[3, E, L] common words of the goal and the whole text, any word, the whole value, with the sum 1 over L."""
    tokens = goal.tokens
    matches = np.zeros((3, len(page), len(tokens)), dtype=np.float32)
    for e in range(len(page)):
        text, value = _words(page.text[e]), _words(page.value[e])
        lower = {word.lower() for word in [*text, *value][:WORDS] if word.isalnum()}
        any_word = [token.lower() in lower for token in tokens]
        # Only the whole text of an element with a common word is searched.
        matches[:, e] = _covered(tokens, text) * any(any_word), any_word, _covered(tokens, value)
    return _normalised(matches)


def _words(text: str) -> list[str]:
    return [match.group() for match in TOKEN.finditer(text)] if text else []


def _covered(tokens: Sequence[str], words: Sequence[str]) -> NDArray[np.float32]:
    """[L] 1 where the complete sequence `words` occurs in `tokens`."""
    covered = np.zeros(len(tokens), dtype=np.float32)
    if words:
        first, n = words[0], len(words)
        for start in range(len(tokens) - n + 1):
            if tokens[start] == first and list(tokens[start : start + n]) == list(words):
                covered[start : start + n] = 1.0
    return covered


def _normalised(matches: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scale each row to the sum 1, unless it is 0, so that it averages the words it covers."""
    total = matches.sum(axis=2, keepdims=True)
    spread: NDArray[np.float32] = np.divide(matches, total, out=matches, where=total > 0)
    return spread


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """The features of B pages, padded to the longest goal and the page with the most elements."""

    token_words: Tensor  # [B, L] int64
    token_flags: Tensor  # [B, L, TOKEN_FLAGS]
    token_mask: Tensor  # [B, L] bool, True for real tokens
    element_words: Tensor  # [B, E, WORDS] int64
    element_kind: Tensor  # [B, E, KIND_WORDS] int64
    element_tag: Tensor  # [B, E] int64
    element_classes: Tensor  # [B, E, CLASS_SLOTS] int64
    element_flags: Tensor  # [B, E, ELEMENT_FLAGS]
    element_mask: Tensor  # [B, E] bool, True for real elements
    same_group: Tensor  # [B, E, E] bool
    relations: Tensor  # [B, E, E] int64
    matches: Tensor  # [B, MATCH_KINDS, E, L]
    clickable: Tensor  # [B, E] bool
    typable: Tensor  # [B, E] bool

    def __len__(self) -> int:
        return int(self.token_words.shape[0])


def collate(rows: Sequence[Features]) -> Batch:
    """Pad and stack the features of B pages, B >= 1."""
    assert rows, "collate needs at least one page"
    size = len(rows)
    length = max(len(row.token_words) for row in rows)
    count = max(1, max(len(row.element_tag) for row in rows))
    arrays: dict[str, NDArray[np.generic]] = {
        "token_words": np.full((size, length), PADDING, dtype=np.int64),
        "token_flags": np.zeros((size, length, TOKEN_FLAGS), dtype=np.float32),
        "token_mask": np.zeros((size, length), dtype=np.bool_),
        "element_words": np.full((size, count, WORDS), PADDING, dtype=np.int64),
        "element_kind": np.full((size, count, KIND_WORDS), PADDING, dtype=np.int64),
        "element_tag": np.zeros((size, count), dtype=np.int64),
        "element_classes": np.zeros((size, count, CLASS_SLOTS), dtype=np.int64),
        "element_flags": np.zeros((size, count, ELEMENT_FLAGS), dtype=np.float32),
        "element_mask": np.zeros((size, count), dtype=np.bool_),
        "same_group": np.zeros((size, count, count), dtype=np.bool_),
        "relations": np.zeros((size, count, count), dtype=np.int64),
        "matches": np.zeros((size, MATCH_KINDS, count, length), dtype=np.float32),
        "clickable": np.zeros((size, count), dtype=np.bool_),
        "typable": np.zeros((size, count), dtype=np.bool_),
    }
    for b, row in enumerate(rows):
        n, e = len(row.token_words), len(row.element_tag)
        arrays["token_mask"][b, :n] = True
        arrays["element_mask"][b, :e] = True
        arrays["matches"][b, :, :e, :n] = row.matches
        for name in ("token_words", "token_flags"):
            arrays[name][b, :n] = getattr(row, name)
        arrays["same_group"][b, :e, :e], arrays["relations"][b, :e, :e] = row.same_group, row.relations
        for name in ("words", "kind", "tag", "classes", "flags"):
            arrays[f"element_{name}"][b, :e] = getattr(row, f"element_{name}")
        arrays["clickable"][b, :e] = row.clickable
        arrays["typable"][b, :e] = row.typable
    return Batch(**{name: torch.from_numpy(array) for name, array in arrays.items()})


def without_overlap(batch: Batch) -> Batch:
    """The batch without the features that mark common words of goal and page."""
    tokens, elements = batch.token_flags.clone(), batch.element_flags.clone()
    tokens[:, :, list(TOKEN_OVERLAP)] = 0.0
    elements[:, :, ELEMENT_OVERLAP] = 0.0
    return replace(batch, token_flags=tokens, element_flags=elements, matches=torch.zeros_like(batch.matches))
