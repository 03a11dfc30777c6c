"""Many pages as tensors, without work on padding: words and elements lie end to end, like sizes share a block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from giirl_core.nets.features import (
    CLASS,
    CLICKABLE,
    ELEMENT_FLAGS,
    ELEMENT_IDS,
    ELEMENT_OVERLAP,
    ELEMENT_WORDS,
    MATCH_KINDS,
    OPEN,
    TAG,
    TOKEN_FLAGS,
    TOKEN_IDS,
    TOKEN_OVERLAP,
    TYPABLE,
    WORD,
    Features,
)

MASKED_LOGIT = -1e9  # of what may not be chosen
SPARE_ROWS = 32  # of padding that a block may hold beside a tenth of its rows: another block would cost more


@dataclass(frozen=True, slots=True)
class Block:
    """Pages of at most `size` elements, whose rows follow each other in the flat table, page by page."""

    pages: Tensor  # [b] int64 which pages of the batch
    size: int
    bias: Tensor | None  # [b, size] 0 for elements, MASKED_LOGIT for padding; None where no page is smaller
    token_row: Tensor  # [b, l] int64, as in the batch, to the longest goal of the block
    token_bias: Tensor  # [b, l] 0 for words, MASKED_LOGIT beyond them

    def to(self, device: torch.device) -> Block:
        """The same on another device."""
        return Block(
            pages=self.pages.to(device),
            size=self.size,
            bias=None if self.bias is None else self.bias.to(device),
            token_row=self.token_row.to(device),
            token_bias=self.token_bias.to(device),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """B pages under their goals: flat words (T rows) and elements (N rows); at most L words and E elements a page.

    Behind the words of each goal lies one row of zeros, which parts them from the next goal's.
    """

    token_words: Tensor  # [T] int64
    token_flags: Tensor  # [T, TOKEN_FLAGS]
    token_open: Tensor  # [T] bool
    token_real: Tensor  # [T] bool, False for the rows between goals
    token_page: Tensor  # [T] int64, the page that a row belongs to
    token_row: Tensor  # [B, L] int64, the flat row of each word, beyond the last that of zeros
    token_mask: Tensor  # [B, L] bool, True for words
    element_words: Tensor  # [N, WORDS] int64
    element_tag: Tensor  # [N] int64
    element_classes: Tensor  # [N, CLASS_SLOTS] int64
    element_flags: Tensor  # [N, ELEMENT_FLAGS]
    element_page: Tensor  # [N] int64, the page that a row belongs to
    matched: Tensor  # [R] int64, the flat rows of elements that match some word
    match_row: Tensor  # [K] int64, MATCH_KINDS * place among the matched + kind
    match_token: Tensor  # [K] int64, a flat row
    match_weight: Tensor  # [K]
    row: Tensor  # [B, E] int64, the flat row of each element
    clickable: Tensor  # [B, E] bool
    typable: Tensor  # [B, E] bool
    blocks: tuple[Block, ...]

    def __len__(self) -> int:
        return int(self.token_row.shape[0])

    def by_block(self, flat: Tensor) -> list[Tensor]:
        """[b, size, ...] of each block from a flat [N, ...]."""
        parts = flat.split([len(block.pages) * block.size for block in self.blocks])
        return [part.unflatten(0, (-1, block.size)) for part, block in zip(parts, self.blocks, strict=True)]

    def to(self, device: torch.device) -> Batch:
        """The same on another device."""
        if self.token_words.device == device:
            return self
        tensors = {f.name: getattr(self, f.name).to(device) for f in fields(self) if f.name != "blocks"}
        return Batch(**tensors, blocks=tuple(block.to(device) for block in self.blocks))


def collate(rows: Sequence[Features]) -> Batch:
    """Stack pages into one batch; an empty sequence is an error of ours."""
    assert rows, "collate needs at least one page"
    sizes = np.array([len(row.element_ids) for row in rows])
    lengths = np.array([len(row.token_ids) for row in rows])
    first_token = np.cumsum(lengths + 1) - lengths - 1
    words = np.repeat(first_token, lengths) + _ranges(lengths)
    total = int(lengths.sum()) + len(rows)
    token_ids = _scatter([row.token_ids for row in rows], words, total, TOKEN_IDS)
    column = np.arange(int(lengths.max()))
    token_row = first_token[:, None] + np.minimum(column, lengths[:, None])
    token_mask = column < lengths[:, None]
    blocks, first_row, count = _blocks(sizes, lengths, token_row, token_mask)
    at = np.repeat(first_row, sizes) + _ranges(sizes)
    ids = _scatter([row.element_ids for row in rows], at, count, ELEMENT_IDS)
    page = np.zeros(count, dtype=np.int64)
    page[at] = np.repeat(np.arange(len(rows)), sizes)
    found = np.array([len(row.match_ids) for row in rows])
    element, kind, token = np.concatenate([row.match_ids for row in rows]).astype(np.int64).T
    matched, place = np.unique(np.repeat(first_row, found) + element, return_inverse=True)
    row = np.minimum(first_row[:, None] + np.arange(max(1, int(sizes.max()))), count - 1)
    real = np.arange(row.shape[1]) < sizes[:, None]
    arrays: dict[str, NDArray[Any]] = {
        "token_words": token_ids[:, WORD].astype(np.int64),
        "token_flags": _scatter([row.token_flags for row in rows], words, total, TOKEN_FLAGS),
        "token_open": token_ids[:, OPEN] > 0,
        "token_real": np.bincount(words, minlength=total) > 0,
        "token_page": np.repeat(np.arange(len(rows)), lengths + 1),
        "token_row": token_row,
        "token_mask": token_mask,
        "element_words": ids[:, ELEMENT_WORDS].astype(np.int64),
        "element_tag": ids[:, TAG].astype(np.int64),
        "element_classes": ids[:, CLASS].astype(np.int64),
        "element_flags": _scatter([row.element_flags for row in rows], at, count, ELEMENT_FLAGS),
        "element_page": page,
        "matched": matched,
        "match_row": place * MATCH_KINDS + kind,
        "match_token": np.repeat(first_token, found) + token,
        "match_weight": np.concatenate([row.match_weights for row in rows]),
        "row": row,
        "clickable": (ids[:, CLICKABLE] > 0)[row] & real,
        "typable": (ids[:, TYPABLE] > 0)[row] & real,
    }
    return Batch(**{name: torch.from_numpy(array) for name, array in arrays.items()}, blocks=blocks)


def _blocks(
    sizes: NDArray[np.int64], lengths: NDArray[np.int64], token_row: NDArray[np.int64], token_mask: NDArray[np.bool_]
) -> tuple[tuple[Block, ...], NDArray[np.int64], int]:
    """Blocks for pages of these sizes, the first flat row of each page, and how many rows there are."""
    order = np.argsort(-sizes, kind="stable")
    first_row = np.zeros(len(sizes), dtype=np.int64)
    blocks, start, row = [], 0, 0
    descending = sizes[order]
    while start < len(order):
        size = max(1, int(descending[start]))
        waste = np.cumsum(size - descending[start:] - size / 10)
        over = np.flatnonzero(waste > SPARE_ROWS)
        end = start + int(over[0]) if len(over) else len(order)
        pages = np.sort(order[start:end])
        first_row[pages] = row + np.arange(len(pages)) * size
        mask = np.arange(size) < sizes[pages][:, None]
        longest = int(lengths[pages].max())
        block = Block(
            pages=torch.from_numpy(pages),
            size=size,
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
    """0 .. n - 1 for every n in turn."""
    ends = np.cumsum(lengths)
    return np.arange(int(ends[-1])) - np.repeat(ends - lengths, lengths)


def _scatter(parts: Sequence[NDArray[Any]], at: NDArray[np.int64], count: int, width: int) -> NDArray[Any]:
    """[count, width] of zeros, with the rows of all parts at their places."""
    table = np.zeros((count, width), dtype=parts[0].dtype)
    table[at] = np.concatenate(parts)
    return table


def without_overlap(batch: Batch) -> Batch:
    """The same pages without the features that say where goal and page agree."""
    tokens, elements = batch.token_flags.clone(), batch.element_flags.clone()
    tokens[:, TOKEN_OVERLAP] = 0.0
    elements[:, ELEMENT_OVERLAP] = 0.0
    return replace(batch, token_flags=tokens, element_flags=elements, match_weight=torch.zeros_like(batch.match_weight))
