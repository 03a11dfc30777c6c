"""Reads pages under their goals after DOMNet (Liu et al. 2018): words, elements, and what they have to do with each other."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import NetConfig
from giirl_core.nets.batch import Batch, without_overlap
from giirl_core.nets.features import (
    CLASSES,
    ELEMENT_FLAGS,
    HEIGHT_PX,
    MATCH_KINDS,
    POSITION,
    RELATIONS,
    TAGS,
    TOKEN_FLAGS,
    WIDTH_PX,
)
from giirl_core.nets.language import PADDING, Vectors

MASKED_LOGIT = -1e9  # of what may not be chosen
ADJACENT_PX = 4.0  # at this distance an adjacent element counts 1 / e
LAYERS = int(os.environ.get("READER_LAYERS", "1"))
POOL = os.environ.get("READER_POOL", "1") == "1"
NORM = os.environ.get("READER_NORM", "") == "1"
LINES_APART = 3.0  # a vertical pixel counts as so many horizontal ones


@dataclass(frozen=True, slots=True)
class Encoding:
    """B pages as read by one net."""

    batch: Batch
    tokens: Tensor  # [T, D] flat, as in the batch
    elements: Tensor  # [N, D] flat
    row: Tensor  # [B, E] the flat row of each element
    token_row: Tensor  # [B, L] the flat row of each word
    token_mask: Tensor  # [B, L]
    summary: Tensor  # [B, D] goal and page together

    def take(self, pages: Tensor) -> Encoding:
        """Some of the pages [b]; the flat rows of all stay at hand."""
        per_page = (self.row, self.token_row, self.token_mask, self.summary)
        return Encoding(self.batch, self.tokens, self.elements, *(part.index_select(0, pages) for part in per_page))

    @property
    def words(self) -> Tensor:
        """[B, L, D] the words of each goal, zeros beyond them."""
        return functional.embedding(self.token_row, self.tokens)

    def element(self, index: Tensor) -> Tensor:
        """[B, M, D] of the elements `index` [B, M]."""
        return functional.embedding(self.row.gather(1, index), self.elements)

    def token(self, index: Tensor) -> Tensor:
        """[B, M, D] of the tokens `index` [B, M]."""
        return functional.embedding(self.token_row.gather(1, index), self.tokens)


class Encoder(nn.Module):
    """Goal tokens and page elements in one space of `width`, elements aligned with the goal and each other."""

    table: Tensor

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        self.config, width = config, config.width
        self.register_buffer("table", torch.from_numpy(vectors.table), persistent=False)
        words = self.table.shape[1]
        self.token_in = nn.Linear(words + TOKEN_FLAGS, width)
        self.token_conv = nn.ModuleList(nn.Conv1d(width, width, 3, padding=1) for _ in range(2))
        self.tag = nn.Embedding(TAGS, 16)
        self.classes = nn.Embedding(CLASSES, 8, padding_idx=0)
        self.element_in = nn.Linear(2 * words + 16 + 8 + ELEMENT_FLAGS, width)
        self.repeated = nn.Linear(width, MATCH_KINDS * width, bias=False)
        self.align = nn.Linear(width, width)
        self.aligned = nn.Linear(2 * width, width)
        self.neighbours = Attention(width)
        self.grouped = nn.Linear(width, width) if POOL else None
        self.more = nn.ModuleList(Attention(width) for _ in range(LAYERS - 1))
        self.beside = nn.Linear(width, width) if config.adjacent_elements else None
        self.goal_pool = nn.Linear(width, 1)
        self.summary = nn.Linear(3 * width, width)

    def forward(self, batch: Batch) -> Encoding:
        batch = batch if self.config.goal_overlap else without_overlap(batch)
        tokens = self._read_goal(batch)
        elements = self._read_page(batch, tokens)
        summary = torch.relu(self.summary(self._pool(batch, tokens, elements)))
        return Encoding(batch, tokens, elements, batch.row, batch.token_row, batch.token_mask, summary)

    def _read_goal(self, batch: Batch) -> Tensor:
        """[T, D]: each word in the light of its neighbours; the rows between goals stay 0."""
        real = batch.token_real.unsqueeze(1)
        words = functional.embedding(batch.token_words, self.table)
        hidden = torch.relu(self.token_in(torch.cat([words, batch.token_flags], 1))) * real
        for conv in self.token_conv if self.config.word_order else ():
            hidden = hidden + torch.relu(conv(hidden.T)).T * real
        return hidden

    def _read_page(self, batch: Batch, tokens: Tensor) -> Tensor:
        """[N, D]: each element with the words of the goal it repeats, the ones it resembles, and its neighbours."""
        text, kind = self._mean_words(batch.element_words), self._mean_words(batch.element_kind)
        classes = functional.embedding_bag(batch.element_classes, self.classes.weight, mode="sum", padding_idx=0)
        own = torch.cat([text, kind, self.tag(batch.element_tag), classes, batch.element_flags], dim=1)
        said = self.repeated(tokens).view(-1, tokens.shape[1])  # each word as each kind of match reads it
        said = functional.embedding(batch.match_token, said) * batch.match_weight.unsqueeze(1)
        hidden = torch.relu(self.element_in(own).index_add(0, batch.match_row, said))
        alignment = self._alignment(batch, hidden, tokens)
        hidden = hidden + torch.relu(self.aligned(torch.cat([hidden, alignment], dim=1)))
        out: Tensor = hidden + self.neighbours(hidden, batch) if self.config.element_attention else hidden
        if self.grouped is not None:
            place = batch.element_group.unsqueeze(1).expand_as(hidden)
            peak = torch.zeros_like(hidden).scatter_reduce(0, place, hidden, "amax", include_self=False)
            out = out + torch.relu(self.grouped(functional.embedding(batch.element_group, peak)))
        for layer in self.more:
            out = out + layer(out, batch)
        if self.beside is not None:
            pairs = zip(nearness(batch), batch.by_block(hidden), strict=True)
            near = [share @ part for share, part in pairs]
            out = out + torch.relu(self.beside(torch.cat([part.flatten(0, 1) for part in near])))
        return out

    def _mean_words(self, rows: Tensor) -> Tensor:
        """[N, D] the mean of the word vectors in each row of [N, W]."""
        read = (rows != PADDING).sum(1, keepdim=True).clamp(min=1)
        out: Tensor = functional.embedding_bag(rows, self.table, mode="sum") / read
        return out

    def _alignment(self, batch: Batch, hidden: Tensor, tokens: Tensor) -> Tensor:
        """[N, D]: the goal's words, each as much as an element resembles it."""
        aligned = []
        for block, query in zip(batch.blocks, batch.by_block(self.align(hidden)), strict=True):
            words = functional.embedding(block.token_row, tokens).unsqueeze(1)
            mask = block.token_mask[:, None, None, :]
            mixed = functional.scaled_dot_product_attention(query.unsqueeze(1), words, words, attn_mask=mask)
            aligned.append(mixed.flatten(0, 2))
        return torch.cat(aligned)

    def _pool(self, batch: Batch, tokens: Tensor, elements: Tensor) -> Tensor:
        """[B, 3 * D]: a weighted mean of each goal's words, mean and maximum of each page's elements."""
        weights = self.goal_pool(tokens).squeeze(1)
        pooled = []
        for block, some in zip(batch.blocks, batch.by_block(elements), strict=True):
            share = weights[block.token_row].masked_fill(~block.token_mask, MASKED_LOGIT).softmax(1)
            goal = torch.bmm(share.unsqueeze(1), functional.embedding(block.token_row, tokens)).squeeze(1)
            if block.mask is None:
                mean, peak = some.mean(1), some.amax(1)
            else:
                real = block.mask.unsqueeze(2)
                mean = (some * real).sum(1) / real.sum(1).clamp(min=1)
                peak = some.masked_fill(~real, MASKED_LOGIT).amax(1)
            pooled.append(torch.cat([goal, mean, peak], dim=1))
        back = torch.cat([block.pages for block in batch.blocks]).argsort()
        return torch.cat(pooled).index_select(0, back)


def nearness(batch: Batch) -> list[Tensor]:
    """[b, E, E] by block: for each element its leaves by pixel distance: shares of those other than itself, 0 of others.

    DOMNet's neighbours in pixels (Liu et al. 2018) in a soft form: most of the weight is on what is adjacent to it in
    its line, where lines are some px apart, edge to edge.
    """
    page = torch.tensor([WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX], device=batch.element_flags.device)
    shares = []
    for block, box in zip(batch.blocks, batch.by_block(batch.element_flags[:, POSITION] * page), strict=True):
        size = box[:, :, 2:]
        centre = box[:, :, :2] + size / 2
        gap = (centre[:, :, None] - centre[:, None]).abs() - (size[:, :, None] + size[:, None]) / 2
        across, down = gap.clamp(min=0).unbind(3)
        leaf = batch.clickable.index_select(0, block.pages)[:, : block.size]
        other = leaf[:, None, :] & ~torch.eye(block.size, dtype=torch.bool, device=box.device)
        scores = (-(across + LINES_APART * down) / ADJACENT_PX).masked_fill(~other, MASKED_LOGIT)
        shares.append(scores.softmax(2) * other)
    return shares


def attended(mask: Tensor) -> Tensor:
    """[b, E] what attention may look at: a page without elements looks at its padding, which nobody reads."""
    return mask | ~mask.any(1, keepdim=True)


class _Lookup(torch.autograd.Function):
    """table[:, codes]: [H, V] and [...] to [H, ...]; for few codes in many places its gradient is a histogram."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, codes: Tensor) -> Tensor:
        ctx.save_for_backward(codes)
        ctx.size = table.shape[1]
        return table.index_select(1, codes.flatten()).unflatten(1, codes.shape)

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        (codes,) = ctx.saved_tensors
        flat = codes.flatten()
        parts = [torch.bincount(flat, weights=part.flatten(), minlength=ctx.size) for part in grad]
        return torch.stack(parts).to(grad.dtype), None


class Attention(nn.Module):
    """Four heads from every element of a page to every other: what stands near what."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.project = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.bias = nn.Parameter(torch.zeros(heads, RELATIONS))
        self.norm = nn.LayerNorm(width) if NORM else nn.Identity()

    def forward(self, x: Tensor, batch: Batch) -> Tensor:
        """[N, D] from the flat [N, D]."""
        mixed = []
        bias = torch.cat([self.bias, self.bias.new_full((self.heads, 1), MASKED_LOGIT)], dim=1)
        for block, part in zip(batch.blocks, batch.by_block(self.project(self.norm(x))), strict=True):
            q, k, v = part.unflatten(2, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).unbind(0)
            mask = _Lookup.apply(bias, block.relations).transpose(0, 1)
            heads = functional.scaled_dot_product_attention(q, k, v, attn_mask=mask)
            mixed.append(heads.transpose(1, 2).flatten(2).flatten(0, 1))
        return torch.relu(self.out(torch.cat(mixed)))
