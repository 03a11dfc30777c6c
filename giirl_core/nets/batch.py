"""A batch of pages as flat tensors, almost without padding.

The words of all goals are rows of one table, the elements of all pages rows of another. For attention, pages of similar
size are grouped into blocks, and only the pages of a block are padded to the same size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from giirl_core.nets.features import Features
from giirl_core.nets.language import PADDING
from giirl_core.nets.layout import (
    CLASS,
    CLICKABLE,
    ELEMENT_FLAGS,
    ELEMENT_IDS,
    ELEMENT_KIND,
    ELEMENT_OVERLAP,
    ELEMENT_WORDS,
    MATCH_KINDS,
    OPEN,
    RELATIONS,
    TAG,
    TOKEN_FLAGS,
    TOKEN_IDS,
    TOKEN_OVERLAP,
    TYPABLE,
    WORD,
)

MASKED_LOGIT = -1e9  # of illegal or padded choices
PADDING_ROWS = 32  # of padding that a block may have in addition to a tenth of its rows; more blocks would be slower


@dataclass(frozen=True, slots=True)
class Block:
    """b pages, each padded to `size` elements. Their rows are consecutive in the flat table, page by page."""

    pages: Tensor  # [b] int64, indices of the pages in the batch
    size: int
    relations: Tensor  # [b, size, size] int64, relation of the element in the column to that in the row; see `collate`
    bias: Tensor | None  # [b, size] for logits: 0 for elements, MASKED_LOGIT for padding; None without padding
    token_row: Tensor  # [b, l] int64, as Batch.token_row, up to the longest goal of the block
    token_bias: Tensor  # [b, l] for logits: 0 for words, MASKED_LOGIT for padding

    def to(self, device: torch.device) -> Block:
        """The block on another device."""
        return Block(
            pages=self.pages.to(device),
            size=self.size,
            relations=self.relations.to(device),
            bias=None if self.bias is None else self.bias.to(device),
            token_row=self.token_row.to(device),
            token_bias=self.token_bias.to(device),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """B pages under their goals, with at most L words per goal and E elements per page.

    The flat tables have T rows of words and N rows of elements. A row of zeros after the words of each goal separates
    it from the next goal, so that convolutions do not mix the two.
    """

    token_words: Tensor  # [T] int64, row of the word vectors
    token_flags: Tensor  # [T, TOKEN_FLAGS]
    token_open: Tensor  # [T] bool, True for words that are quoted, on the page, or MOST_SIMILAR
    token_real: Tensor  # [T] bool, False for the rows between goals
    token_page: Tensor  # [T] int64, page of each row
    token_row: Tensor  # [B, L] int64, flat row of each word; after the last word, the row of zeros
    token_mask: Tensor  # [B, L] bool, True for words
    text_words: Tensor  # [W] int64, rows of the word vectors: the words of each element, one element after the other
    text_page: Tensor  # [W] int64, page of each
    text_first: Tensor  # [N] int64, index of the first word of each element
    kind_words: Tensor  # [X] int64, rows of the word vectors: the words for the kind of each element
    kind_first: Tensor  # [N] int64, index of the first of them for each element
    element_tag: Tensor  # [N] int64, hash bucket
    element_classes: Tensor  # [N, CLASS_SLOTS] int64, hash buckets, 0 for none
    element_flags: Tensor  # [N, ELEMENT_FLAGS]
    element_group: Tensor  # [N] int64, flat row of the repeated ancestor, e.g. a row of a table; its own if none
    element_page: Tensor  # [N] int64, page of each row
    match_row: Tensor  # [K] int64, flat row of the element
    match_token: Tensor  # [K] int64, MATCH_KINDS * flat row of the matching word + kind of the match
    match_weight: Tensor  # [K] the weights of one element and kind sum to 1
    row: Tensor  # [B, E] int64, flat row of each element; arbitrary after the last element
    real: Tensor  # [B, E] bool, False after the last element
    clickable: Tensor  # [B, E] bool, False after the last element
    typable: Tensor  # [B, E] bool, False after the last element
    blocks: tuple[Block, ...]

    def __len__(self) -> int:
        return int(self.token_row.shape[0])

    def by_block(self, flat: Tensor) -> list[Tensor]:
        """[b, size, ...] for each block, from a flat tensor [N, ...]."""
        parts = flat.split([len(block.pages) * block.size for block in self.blocks])
        return [part.unflatten(0, (-1, block.size)) for part, block in zip(parts, self.blocks, strict=True)]

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        if self.token_words.device == device:
            return self
        tensors = {f.name: getattr(self, f.name).to(device) for f in fields(self) if f.name != "blocks"}
        return Batch(**tensors, blocks=tuple(block.to(device) for block in self.blocks))


def collate(rows: Sequence[Features]) -> Batch:
    """Collate the features of B pages, B >= 1, into one batch. RELATIONS marks padding in `Block.relations`."""
    assert rows, "collate needs at least one page"
    sizes = np.array([len(row.element_ids) for row in rows])
    lengths = np.array([len(row.token_ids) for row in rows])
    first_token = np.cumsum(lengths + 1) - lengths - 1
    word_rows = np.repeat(first_token, lengths) + _ranges(lengths)
    token_count = int(lengths.sum()) + len(rows)
    token_ids = _scatter([row.token_ids for row in rows], word_rows, token_count, TOKEN_IDS)
    column = np.arange(int(lengths.max()))
    token_row = first_token[:, None] + np.minimum(column, lengths[:, None])
    token_mask = column < lengths[:, None]
    blocks, first_row, count = _blocks(sizes, lengths, token_row, token_mask, [row.relations for row in rows])
    element_rows = np.repeat(first_row, sizes) + _ranges(sizes)
    ids = _scatter([row.element_ids for row in rows], element_rows, count, ELEMENT_IDS)
    page = np.zeros(count, dtype=np.int64)
    page[element_rows] = np.repeat(np.arange(len(rows)), sizes)
    group = np.arange(count)
    group[element_rows] = np.repeat(first_row, sizes) + np.concatenate([row.group for row in rows])
    match_counts = np.array([len(row.match_ids) for row in rows])
    text_words, text_counts, text_first = _flat_words(ids[:, ELEMENT_WORDS])
    kind_words, _, kind_first = _flat_words(ids[:, ELEMENT_KIND])
    element, kind, token = np.concatenate([row.match_ids for row in rows]).astype(np.int64).T
    row = np.minimum(first_row[:, None] + np.arange(max(1, int(sizes.max()))), count - 1)
    real = np.arange(row.shape[1]) < sizes[:, None]
    arrays: dict[str, NDArray[Any]] = {
        "token_words": token_ids[:, WORD].astype(np.int64),
        "token_flags": _scatter([row.token_flags for row in rows], word_rows, token_count, TOKEN_FLAGS),
        "token_open": token_ids[:, OPEN] > 0,
        "token_real": np.bincount(word_rows, minlength=token_count) > 0,
        "token_page": np.repeat(np.arange(len(rows)), lengths + 1),
        "token_row": token_row,
        "token_mask": token_mask,
        "text_words": text_words,
        "text_page": np.repeat(page, text_counts),
        "text_first": text_first,
        "kind_words": kind_words,
        "kind_first": kind_first,
        "element_tag": ids[:, TAG].astype(np.int64),
        "element_classes": ids[:, CLASS].astype(np.int64),
        "element_flags": _scatter([row.element_flags for row in rows], element_rows, count, ELEMENT_FLAGS),
        "element_group": group,
        "element_page": page,
        "match_row": np.repeat(first_row, match_counts) + element,
        "match_token": (np.repeat(first_token, match_counts) + token) * MATCH_KINDS + kind,
        "match_weight": np.concatenate([row.match_weights for row in rows]),
        "row": row,
        "real": real,
        "clickable": (ids[:, CLICKABLE] > 0)[row] & real,
        "typable": (ids[:, TYPABLE] > 0)[row] & real,
    }
    return Batch(**{name: torch.from_numpy(array) for name, array in arrays.items()}, blocks=blocks)


def _flat_words(rows: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Rows of the word vectors [N, W] without padding: all of them, the number and the first index of each element."""
    read = rows != PADDING
    counts = read.sum(1)
    return rows[read].astype(np.int64), counts, np.cumsum(counts) - counts


def _blocks(
    sizes: NDArray[np.int64],
    lengths: NDArray[np.int64],
    token_row: NDArray[np.int64],
    token_mask: NDArray[np.bool_],
    page_relations: Sequence[NDArray[np.uint8]],
) -> tuple[tuple[Block, ...], NDArray[np.int64], int]:
    """Group pages by size. Returns the blocks, the first flat row of each page [B], and the number of flat rows N."""
    order = np.argsort(-sizes, kind="stable")
    first_row = np.zeros(len(sizes), dtype=np.int64)
    blocks, start, row = [], 0, 0
    descending = sizes[order]
    while start < len(order):
        size = max(1, int(descending[start]))
        padding = np.cumsum(size - descending[start:] - size / 10)
        too_much = np.flatnonzero(padding > PADDING_ROWS)
        end = start + int(too_much[0]) if len(too_much) else len(order)
        pages = np.sort(order[start:end])
        first_row[pages] = row + np.arange(len(pages)) * size
        mask = np.arange(size) < sizes[pages][:, None]
        longest = int(lengths[pages].max())
        relations = np.full((len(pages), size, size), RELATIONS, dtype=np.int64)
        for index, page in enumerate(pages.tolist()):
            relations[index, : sizes[page], : sizes[page]] = page_relations[page]
        block = Block(
            pages=torch.from_numpy(pages),
            size=size,
            relations=torch.from_numpy(relations),
            bias=None if mask.all() else _bias(mask),
            token_row=torch.from_numpy(token_row[pages, :longest]),
            token_bias=_bias(token_mask[pages, :longest]),
        )
        blocks.append(block)
        row += len(pages) * size
        start = end
    return tuple(blocks), first_row, row


def _bias(mask: NDArray[np.bool_]) -> Tensor:
    """What to add to logits: 0 where `mask` is True, MASKED_LOGIT elsewhere. Equal logits where it is never True."""
    return torch.from_numpy(np.where(mask, np.float32(0), np.float32(MASKED_LOGIT)))


def _ranges(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """0 .. n - 1 for each n of `lengths`, concatenated."""
    ends = np.cumsum(lengths)
    return np.arange(int(ends[-1])) - np.repeat(ends - lengths, lengths)


def _scatter(parts: Sequence[NDArray[Any]], rows: NDArray[np.int64], count: int, width: int) -> NDArray[Any]:
    """[count, width] zeros, with the concatenated rows of `parts` written to `rows`."""
    table = np.zeros((count, width), dtype=parts[0].dtype)
    table[rows] = np.concatenate(parts)
    return table


def without_overlap(batch: Batch) -> Batch:
    """The batch without the features that mark common words of goal and page, for the ablation `net.goal_overlap`."""
    tokens, elements = batch.token_flags.clone(), batch.element_flags.clone()
    tokens[:, TOKEN_OVERLAP] = 0.0
    elements[:, ELEMENT_OVERLAP] = 0.0
    return replace(batch, token_flags=tokens, element_flags=elements, match_weight=torch.zeros_like(batch.match_weight))
