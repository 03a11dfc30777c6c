"""Reference implementation of the features, for tests: plain loops and padded tables [B, E, ...].

`giirl_core.nets.features`, `batch` and `augment` must give the same values.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from giirl_core.nets.language import FIRST_WORD, PADDING, UNKNOWN, Vectors
from giirl_core.types import NO_SPAN, TOKEN, Action, Goal, Page, Verb

WORDS = 8  # words of an element that the nets read
TAGS = 128  # hash buckets of tag names
CLASSES = 64  # hash buckets of class names
CLASS_SLOTS = 3
TOKEN_FLAGS = 6
ELEMENT_FLAGS = 16
ELEMENT_OVERLAP, TOKEN_OVERLAP = slice(10, 16), slice(3, 5)  # columns that mark common words of goal and page
POSITION = slice(0, 4)  # columns of Features.element_flags with left, top, width, height
WIDTH_PX, HEIGHT_PX = 160.0, 210.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """One page under one goal: L goal tokens, E elements."""

    token_words: NDArray[np.int64]  # [L] row of the word vectors
    token_flags: NDArray[np.float32]  # [L, TOKEN_FLAGS]
    token_open: NDArray[np.bool_]  # [L] True for words that are quoted or on the page
    element_words: NDArray[np.int64]  # [E, WORDS] row of the word vectors, 0 after the last word
    element_tag: NDArray[np.int64]  # [E]
    element_classes: NDArray[np.int64]  # [E, CLASS_SLOTS]
    element_flags: NDArray[np.float32]  # [E, ELEMENT_FLAGS]
    matches: NDArray[np.float32]  # [3, E, L] common words of the goal and the whole text, any word, the whole value
    clickable: NDArray[np.bool_]  # [E]
    typable: NDArray[np.bool_]  # [E]


def featurise(page: Page, goal: Goal, vectors: Vectors) -> Features:
    """The features of a page under a goal. Overlap is case-sensitive, except where words are `folded`."""
    tokens, folded = goal.tokens, [token.lower() for token in goal.tokens]
    quoted = _quoted(goal)
    count, length = len(page), len(tokens)
    leaf, typable = page.leaf, page.typable
    words = np.full((count, WORDS), PADDING, dtype=np.int64)
    tags = np.zeros(count, dtype=np.int64)
    classes = np.zeros((count, CLASS_SLOTS), dtype=np.int64)
    flags = np.zeros((count, ELEMENT_FLAGS), dtype=np.float32)
    matches = np.zeros((3, count, length), dtype=np.float32)
    flags[:, POSITION] = page.box / (WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX)
    on_page: set[str] = set()
    for e in range(count):
        text, value = _words(page.text[e]), _words(page.value[e])
        read = (*text, *value)[:WORDS]
        words[e, : len(read)] = [vectors.row(word) for word in read]
        tags[e] = zlib.crc32(page.tag[e].encode()) % TAGS
        named = page.classes[e].split()[:CLASS_SLOTS]
        classes[e, : len(named)] = [1 + zlib.crc32(name.encode()) % (CLASSES - 1) for name in named]
        lower = {word.lower() for word in read}
        on_page |= lower
        whole, held = _covered(tokens, text), _covered(tokens, value)
        matches[:, e] = whole, [token in lower for token in folded], held
        flags[e, 4:] = (
            page.focused[e],
            page.tampered[e],
            leaf[e],
            typable[e],
            bool(text),
            bool(value),
            whole.any(),
            bool((whole * quoted).any()),
            _covered(folded, [word.lower() for word in text]).any(),
            len(lower & set(folded)) / max(len(lower), 1),
            held.any(),
            bool((held * quoted).any()),
        )
    return Features(
        token_words=np.array([vectors.row(token) for token in tokens], dtype=np.int64),
        token_flags=np.stack(
            [
                np.array([token == '"' for token in tokens]),
                np.array([not token.isalnum() for token in tokens]),
                np.array([token[:1].isupper() for token in tokens]),
                np.array([token in on_page for token in folded]),
                matches[2].any(axis=0) if count else np.zeros(length, dtype=np.bool_),
                quoted,
            ],
            axis=1,
        ).astype(np.float32),
        token_open=quoted | np.array([token in on_page for token in folded]),
        element_words=words,
        element_tag=tags,
        element_classes=classes,
        element_flags=flags,
        matches=_normalised(matches),
        clickable=leaf,
        typable=typable,
    )


def _words(text: str) -> list[str]:
    return [match.group() for match in TOKEN.finditer(text)] if text else []


def _quoted(goal: Goal) -> NDArray[np.bool_]:
    """[L] True between a pair of double quotes."""
    marks = np.cumsum([token == '"' for token in goal.tokens])
    inside: NDArray[np.bool_] = (marks % 2 == 1) & np.array([token != '"' for token in goal.tokens])
    return inside


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
    token_open: Tensor  # [B, L] bool
    token_mask: Tensor  # [B, L] bool, True for real tokens
    element_words: Tensor  # [B, E, WORDS] int64
    element_tag: Tensor  # [B, E] int64
    element_classes: Tensor  # [B, E, CLASS_SLOTS] int64
    element_flags: Tensor  # [B, E, ELEMENT_FLAGS]
    element_mask: Tensor  # [B, E] bool, True for real elements
    matches: Tensor  # [B, 3, E, L]
    clickable: Tensor  # [B, E] bool
    typable: Tensor  # [B, E] bool

    def __len__(self) -> int:
        return int(self.token_words.shape[0])


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionBatch:
    """M actions on each of B pages. `start` and `end` are the first and last goal token to type, -1 for none."""

    verb: Tensor  # [B, M] int64
    element: Tensor  # [B, M] int64
    start: Tensor  # [B, M] int64
    end: Tensor  # [B, M] int64

    def first(self) -> list[Action]:
        """[B] the first action on each page."""
        columns = (part[:, 0].tolist() for part in (self.verb, self.element, self.start, self.end))
        return [
            Action(verb=Verb(verb), element=element, start=start, end=end)
            for verb, element, start, end in zip(*columns, strict=True)
        ]


def collate(rows: Sequence[Features]) -> Batch:
    """Pad and stack the features of B pages, B >= 1."""
    assert rows, "collate needs at least one page"
    size = len(rows)
    length = max(len(row.token_words) for row in rows)
    count = max(1, max(len(row.element_tag) for row in rows))
    arrays: dict[str, NDArray[np.generic]] = {
        "token_words": np.full((size, length), PADDING, dtype=np.int64),
        "token_flags": np.zeros((size, length, TOKEN_FLAGS), dtype=np.float32),
        "token_open": np.zeros((size, length), dtype=np.bool_),
        "token_mask": np.zeros((size, length), dtype=np.bool_),
        "element_words": np.full((size, count, WORDS), PADDING, dtype=np.int64),
        "element_tag": np.zeros((size, count), dtype=np.int64),
        "element_classes": np.zeros((size, count, CLASS_SLOTS), dtype=np.int64),
        "element_flags": np.zeros((size, count, ELEMENT_FLAGS), dtype=np.float32),
        "element_mask": np.zeros((size, count), dtype=np.bool_),
        "matches": np.zeros((size, 3, count, length), dtype=np.float32),
        "clickable": np.zeros((size, count), dtype=np.bool_),
        "typable": np.zeros((size, count), dtype=np.bool_),
    }
    for b, row in enumerate(rows):
        n, e = len(row.token_words), len(row.element_tag)
        arrays["token_mask"][b, :n] = True
        arrays["element_mask"][b, :e] = True
        arrays["matches"][b, :, :e, :n] = row.matches
        for name in ("token_words", "token_flags", "token_open"):
            arrays[name][b, :n] = getattr(row, name)
        for name in ("words", "tag", "classes", "flags"):
            arrays[f"element_{name}"][b, :e] = getattr(row, f"element_{name}")
        arrays["clickable"][b, :e] = row.clickable
        arrays["typable"][b, :e] = row.typable
    return Batch(**{name: torch.from_numpy(array) for name, array in arrays.items()})


def collate_actions(actions: Sequence[Action]) -> ActionBatch:
    """[B, 1] one action on each of B pages."""
    verb, element, start, end = _table(actions).unsqueeze(2)
    return ActionBatch(verb=verb, element=element, start=start, end=end)


def collate_candidates(actions: Sequence[Action]) -> ActionBatch:
    """[1, M] M candidate actions on one page."""
    verb, element, start, end = _table(actions).unsqueeze(1)
    return ActionBatch(verb=verb, element=element, start=start, end=end)


def _table(actions: Sequence[Action]) -> Tensor:
    """[4, B]: verb, element, start, end."""
    table = np.array([(a.verb, a.element, a.start, a.end) for a in actions], dtype=np.int64).reshape(-1, 4)
    return torch.from_numpy(table).T.contiguous()


def rename(batch: Batch, actions: ActionBatch, prob: float, jitter: float, generator: torch.Generator) -> Batch:
    """Replace the open words of some pages by random ones, and shift their boxes, as `giirl_core.nets.augment`."""
    size = len(batch)
    chosen = torch.rand(size, generator=generator) < prob
    salt = torch.randint(1, 1 << 30, (size,), generator=generator) | 1
    rows = torch.arange(batch.token_words.shape[1])
    typed = (rows >= actions.start) & (rows <= actions.end) & (actions.start != NO_SPAN)
    renamed = (batch.token_open | typed) & (batch.token_words >= FIRST_WORD) & chosen[:, None]
    shift = (torch.rand(size, 1, 2, generator=generator) * 2 - 1) * jitter * chosen[:, None, None]
    flags = batch.element_flags.clone()
    flags[:, :, :2] += shift
    return replace(
        batch,
        token_words=torch.where(renamed, _replacement(batch.token_words, salt[:, None]), batch.token_words),
        element_words=torch.where(
            (batch.element_words >= FIRST_WORD) & chosen[:, None, None],
            _replacement(batch.element_words, salt[:, None, None]),
            batch.element_words,
        ),
        element_flags=flags,
    )


def without_overlap(batch: Batch) -> Batch:
    """The batch without the features that mark common words of goal and page."""
    tokens, elements = batch.token_flags.clone(), batch.element_flags.clone()
    tokens[:, :, TOKEN_OVERLAP] = 0.0
    elements[:, :, ELEMENT_OVERLAP] = 0.0
    return replace(batch, token_flags=tokens, element_flags=elements, matches=torch.zeros_like(batch.matches))


COMMON_WORDS = 4000  # replacements are among this many most frequent words of the table


def _replacement(words: Tensor, salt: Tensor) -> Tensor:
    """A word that depends only on the old word and the salt; one in eight is an unknown word."""
    mixed = ((words * 2654435761 + salt * 40503) ^ (salt >> 3)) & 0x7FFFFFFF
    return torch.where(mixed % 8 == 0, UNKNOWN, FIRST_WORD + (mixed >> 3) % COMMON_WORDS)
