"""Many pages as tensors without work on padding: words and elements lie end to end, pages of like size share a block."""

from __future__ import annotations

import os
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
    Features,
)
from giirl_core.nets.language import FIRST_WORD, UNKNOWN
from giirl_core.types import NO_SPAN, Action, Trajectory, Verb

SPARE_ROWS = 32  # of padding that a block may hold beside a tenth of its rows: another block would cost more
SHARED = os.environ.get("READER_SHARED", "1") == "1"
DROP = float(os.environ.get("READER_DROP", "0.2"))
COMMON_WORDS = 4000  # renamed words come from this many of the commonest, whatever the table


@dataclass(frozen=True, slots=True)
class Block:
    """Pages of at most `size` elements, whose rows follow each other in the flat table, page by page."""

    pages: Tensor  # [b] int64 which pages of the batch
    size: int
    relations: Tensor  # [b, size, size] int64, RELATIONS where a column is padding
    mask: Tensor | None  # [b, size] bool, True for elements; None where no page is smaller
    token_row: Tensor  # [b, l] int64, as in the batch, to the longest goal of the block
    token_mask: Tensor  # [b, l] bool

    def to(self, device: torch.device) -> Block:
        """The same on another device."""
        tensors = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "size"}
        moved = {name: None if part is None else part.to(device) for name, part in tensors.items()}
        return replace(self, **moved)


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """B pages under their goals: words and elements flat, T and N rows; L words in the longest goal, E the fullest page.

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
    element_kind: Tensor  # [N, KIND_WORDS] int64
    element_tag: Tensor  # [N] int64
    element_classes: Tensor  # [N, CLASS_SLOTS] int64
    element_flags: Tensor  # [N, ELEMENT_FLAGS]
    element_group: Tensor  # [N] int64, the flat row of the ancestor that repeats, or its own
    element_page: Tensor  # [N] int64, the page that a row belongs to
    match_row: Tensor  # [K] int64, the flat row of the element
    match_token: Tensor  # [K] int64, MATCH_KINDS * flat row of the token + kind
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


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionBatch:
    """M actions on each of B pages: verb, element and the span of the goal that is copied (-1 where none)."""

    verb: Tensor  # [B, M] int64
    element: Tensor  # [B, M] int64
    start: Tensor  # [B, M] int64
    end: Tensor  # [B, M] int64

    def columns(self, first: int, last: int) -> ActionBatch:
        """[B, last - first] some of the M actions on each page."""
        return ActionBatch(**{f.name: getattr(self, f.name)[:, first:last] for f in fields(self)})

    def replace_first(self, first: ActionBatch) -> ActionBatch:
        """The same with the actions `first` [b, M] on the first b pages."""
        columns = {f.name: (getattr(first, f.name), getattr(self, f.name)) for f in fields(self)}
        return ActionBatch(**{name: torch.cat([new, old[len(new) :]]) for name, (new, old) in columns.items()})

    def table(self) -> Tensor:
        """[B, M, 4] verb, element, start and end."""
        return torch.stack([self.verb, self.element, self.start, self.end], dim=2)

    def first(self) -> list[Action]:
        """The first action of each page."""
        columns = (part[:, 0].tolist() for part in (self.verb, self.element, self.start, self.end))
        return [
            Action(verb=Verb(verb), element=element, start=start, end=end)
            for verb, element, start, end in zip(*columns, strict=True)
        ]

    def to(self, device: torch.device) -> ActionBatch:
        """The same on another device."""
        return ActionBatch(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})


def join(*parts: ActionBatch) -> ActionBatch:
    """[B, sum of M]: the actions of each part in turn."""
    return ActionBatch(
        **{f.name: torch.cat([getattr(part, f.name) for part in parts], dim=1) for f in fields(ActionBatch)}
    )


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
    blocks, first_row, count = _blocks(sizes, lengths, token_row, token_mask, [row.relations for row in rows])
    at = np.repeat(first_row, sizes) + _ranges(sizes)
    ids = _scatter([row.element_ids for row in rows], at, count, ELEMENT_IDS)
    page = np.zeros(count, dtype=np.int64)
    page[at] = np.repeat(np.arange(len(rows)), sizes)
    group = np.arange(count)
    group[at] = np.repeat(first_row, sizes) + np.concatenate([row.group for row in rows])
    found = np.array([len(row.match_ids) for row in rows])
    element, kind, token = np.concatenate([row.match_ids for row in rows]).astype(np.int64).T
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
        "element_kind": ids[:, ELEMENT_KIND].astype(np.int64),
        "element_tag": ids[:, TAG].astype(np.int64),
        "element_classes": ids[:, CLASS].astype(np.int64),
        "element_flags": _scatter([row.element_flags for row in rows], at, count, ELEMENT_FLAGS),
        "element_group": group,
        "element_page": page,
        "match_row": np.repeat(first_row, found) + element,
        "match_token": (np.repeat(first_token, found) + token) * MATCH_KINDS + kind,
        "match_weight": np.concatenate([row.match_weights for row in rows]),
        "row": row,
        "clickable": (ids[:, CLICKABLE] > 0)[row] & real,
        "typable": (ids[:, TYPABLE] > 0)[row] & real,
    }
    return Batch(**{name: torch.from_numpy(array) for name, array in arrays.items()}, blocks=blocks)


def _blocks(
    sizes: NDArray[np.int64],
    lengths: NDArray[np.int64],
    token_row: NDArray[np.int64],
    token_mask: NDArray[np.bool_],
    related: Sequence[NDArray[np.uint8]],
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
        relations = np.full((len(pages), size, size), RELATIONS, dtype=np.int64)
        for place, which in enumerate(pages.tolist()):
            relations[place, : sizes[which], : sizes[which]] = related[which]
        block = Block(
            pages=torch.from_numpy(pages),
            size=size,
            relations=torch.from_numpy(relations),
            mask=None if mask.all() else torch.from_numpy(mask),
            token_row=torch.from_numpy(token_row[pages, :longest]),
            token_mask=torch.from_numpy(token_mask[pages, :longest]),
        )
        blocks.append(block)
        row += len(pages) * size
        start = end
    return tuple(blocks), first_row, row


def _ranges(lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """0 .. n - 1 for every n in turn."""
    ends = np.cumsum(lengths)
    return np.arange(int(ends[-1])) - np.repeat(ends - lengths, lengths)


def _scatter(parts: Sequence[NDArray[Any]], at: NDArray[np.int64], count: int, width: int) -> NDArray[Any]:
    """[count, width] of zeros, with the rows of all parts at their places."""
    table = np.zeros((count, width), dtype=parts[0].dtype)
    table[at] = np.concatenate(parts)
    return table


def collate_actions(actions: Sequence[Action]) -> ActionBatch:
    """One action for each of B pages."""
    verb, element, start, end = _table(actions).unsqueeze(2)
    return ActionBatch(verb=verb, element=element, start=start, end=end)


def collate_choices(actions: Sequence[Action]) -> ActionBatch:
    """M actions on one page."""
    verb, element, start, end = _table(actions).unsqueeze(1)
    return ActionBatch(verb=verb, element=element, start=start, end=end)


def collate_sampled(trajectories: Sequence[Trajectory]) -> tuple[ActionBatch, Tensor]:
    """The sampled actions [sum T, M] on every page of every trajectory, and their log-probabilities then, nats.

    M is 0 where no trajectory has any; ValueError where their M differ.
    """
    sampled = [trajectory.sampled for trajectory in trajectories]
    counts = {part.logp.shape[1] if part is not None else 0 for part in sampled}
    if len(counts) != 1:
        raise ValueError(f"trajectories have {sorted(counts)} sampled actions a step, wanted the same number for all")
    steps = sum(map(len, trajectories))
    parts = [part for part in sampled if part is not None]
    table = np.concatenate([part.choices for part in parts]) if parts else np.zeros((steps, 0, 4), np.int16)
    logp = np.concatenate([part.logp for part in parts]) if parts else np.zeros((steps, 0), np.float32)
    verb, element, start, end = torch.from_numpy(table.astype(np.int64)).unbind(2)
    return ActionBatch(verb=verb, element=element, start=start, end=end), torch.from_numpy(logp)


def _table(actions: Sequence[Action]) -> Tensor:
    """[4, B]: verb, element, start, end."""
    table = np.array([(a.verb, a.element, a.start, a.end) for a in actions], dtype=np.int64).reshape(-1, 4)
    return torch.from_numpy(table).T.contiguous()


def rename(batch: Batch, actions: ActionBatch, prob: float, jitter: float, generator: torch.Generator) -> Batch:
    """The same pages in other words: open words become random ones, alike in goal and page.

    A page is renamed with probability `prob`. Open are the words that the page gives their meaning and those that its
    first action types. Overlap features stay as they are, since renaming is consistent. The boxes of such a page
    shift together by up to `jitter` of the page. A net that sees this must read which words agree, and cannot
    remember which pages were demonstrated. `generator` is of the CPU.
    """
    size, device, token_page = len(batch), batch.token_words.device, batch.token_page
    chosen = (torch.rand(size, generator=generator) < prob).to(device)
    salt = (torch.randint(1, 1 << 30, (size,), generator=generator) | 1).to(device)
    shift = (torch.rand(size, 2, generator=generator) * 2 - 1).to(device) * jitter * chosen[:, None]
    position = torch.arange(len(token_page), device=device) - batch.token_row[token_page, 0]
    start, end = actions.start[token_page, 0], actions.end[token_page, 0]
    typed = (position >= start) & (position <= end) & (start != NO_SPAN)
    opened = (batch.token_open | typed) & (batch.token_words >= FIRST_WORD) & chosen[token_page]
    page = batch.element_page
    if DROP:
        lost = (torch.rand(len(token_page), generator=generator) < DROP).to(device)
        lost = lost & ~opened & chosen[token_page] & (batch.token_words >= FIRST_WORD)
        batch = replace(batch, token_words=torch.where(lost, UNKNOWN, batch.token_words))
        missing = (torch.rand(batch.element_words.shape, generator=generator) < DROP).to(device)
        missing = missing & chosen[batch.element_page, None] & (batch.element_words >= FIRST_WORD)
        batch = replace(batch, element_words=torch.where(missing, UNKNOWN, batch.element_words))
    words = int(batch.token_words.max()) + 1
    shared = torch.isin(batch.element_words + page[:, None] * words, (batch.token_words + token_page * words)[opened])
    shared &= batch.element_words < words
    flags = batch.element_flags.clone()
    flags[:, :2] += shift[page]
    return replace(
        batch,
        token_words=torch.where(opened, _other(batch.token_words, salt[token_page]), batch.token_words),
        element_words=torch.where(
            shared if SHARED else (batch.element_words >= FIRST_WORD) & chosen[page, None],
            _other(batch.element_words, salt[page, None]),
            batch.element_words,
        ),
        element_flags=flags,
    )


def without_overlap(batch: Batch) -> Batch:
    """The same pages without the features that say where goal and page agree."""
    tokens, elements = batch.token_flags.clone(), batch.element_flags.clone()
    tokens[:, TOKEN_OVERLAP] = 0.0
    elements[:, ELEMENT_OVERLAP] = 0.0
    return replace(batch, token_flags=tokens, element_flags=elements, match_weight=torch.zeros_like(batch.match_weight))


def _other(words: Tensor, salt: Tensor) -> Tensor:
    """A word that depends on the old word and the salt alone; one in eight is a word the table lacks."""
    mixed = ((words * 2654435761 + salt * 40503) ^ (salt >> 3)) & 0x7FFFFFFF
    return torch.where(mixed % 8 == 0, UNKNOWN, FIRST_WORD + (mixed >> 3) % COMMON_WORDS)


def random_actions(batch: Batch, uniform: Tensor) -> ActionBatch:
    """M actions for each page, uniform over what is legal, driven by `uniform` [B, M, 3] in [0, 1)."""
    legal = torch.stack([batch.clickable, batch.typable], dim=2).flatten(1)  # [B, E * verbs], verbs CLICK and TYPE
    share = legal.sum(1, keepdim=True)
    nth = (uniform[:, :, 0] * share).long().clamp(max=share - 1).contiguous()
    pair = torch.searchsorted(legal.long().cumsum(1), nth, right=True)
    words = batch.token_mask.sum(1, keepdim=True)
    start = (uniform[:, :, 1] * words).long().clamp(max=words - 1)
    end = start + (uniform[:, :, 2] * (words - start)).long().clamp(max=words - start - 1)
    verb, none = pair % 2, torch.full_like(start, NO_SPAN)
    typing = verb == Verb.TYPE
    return ActionBatch(
        verb=verb,
        element=pair // 2,
        start=torch.where(typing, start, none),
        end=torch.where(typing, end, none),
    )


def random_logp(batch: Batch, actions: ActionBatch) -> Tensor:
    """[B, M] log-probability of actions under `random_actions`, nats."""
    pairs = (batch.clickable.sum(1) + batch.typable.sum(1)).unsqueeze(1).float()
    words = batch.token_mask.sum(1, keepdim=True).float()
    copied = words.log() + (words - actions.start.clamp(min=0)).log()
    return -pairs.log() - torch.where(actions.verb == Verb.TYPE, copied, 0.0)
