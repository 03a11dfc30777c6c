"""The encoder of policy and reward, after DOMNet (Liu et al. 2018): encodes pages under their goals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import NetConfig
from giirl_core.nets.batch import MASKED_LOGIT, Batch, without_overlap
from giirl_core.nets.language import Vectors
from giirl_core.nets.layout import (
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

ADJACENT_PX = 4.0  # the distance at which the weight of an adjacent element falls to 1 / e
VERTICAL_WEIGHT = 3.0  # a vertical pixel counts as this many horizontal ones, so that lines stay apart


@dataclass(frozen=True, slots=True)
class Encoding:
    """B pages, encoded by one net. D is the width of the net; T, N, L and E are as in Batch."""

    batch: Batch
    tokens: Tensor  # [T, D] goal tokens, flat
    elements: Tensor  # [N, D] page elements, flat
    row: Tensor  # [B, E] flat row of each element
    element_mask: Tensor  # [B, E] True for elements, False for padding
    token_row: Tensor  # [B, L] flat row of each goal token
    token_mask: Tensor  # [B, L] True for tokens, False for padding
    summary: Tensor  # [B, D] of goal and page together

    def select(self, pages: Tensor) -> Encoding:
        """The encoding of b of the pages, given by their indices [b]. The flat tables stay complete."""
        per_page = (self.row, self.element_mask, self.token_row, self.token_mask, self.summary)
        return Encoding(self.batch, self.tokens, self.elements, *(part.index_select(0, pages) for part in per_page))

    @property
    def goal_tokens(self) -> Tensor:
        """[B, L, D] the tokens of each goal, 0 after the last one."""
        return functional.embedding(self.token_row, self.tokens)

    @property
    def page_elements(self) -> Tensor:
        """[B, E, D] the elements of each page, arbitrary after the last one."""
        return functional.embedding(self.row, self.elements)

    def element(self, index: Tensor) -> Tensor:
        """[B, M, D] the elements with the page indices `index` [B, M]."""
        return functional.embedding(self.row.gather(1, index), self.elements)

    def token(self, index: Tensor) -> Tensor:
        """[B, M, D] the goal tokens with the indices `index` [B, M]."""
        return functional.embedding(self.token_row.gather(1, index), self.tokens)


class Encoder(nn.Module):
    """Encodes goal tokens and page elements with `config.width` units each.

    Elements attend to the goal and to the other elements of the page, with a bias for each relation between two
    elements. Elements in the same row of a table also share the maximum of their units.
    """

    table: Tensor  # [V, W] word vectors, not trained

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        self.config, width = config, config.width
        self.register_buffer("table", torch.from_numpy(vectors.table), persistent=False)
        words = self.table.shape[1]
        self.token_in = nn.Linear(words + TOKEN_FLAGS, width)
        self.token_conv = nn.ModuleList(
            nn.Linear(3 * width, width) for _ in range(2)
        )  # of a word and its two neighbours
        self.tag = nn.Embedding(TAGS, 16)
        self.classes = nn.Embedding(CLASSES, 8, padding_idx=0)
        self.element_in = nn.Linear(2 * words + 16 + 8 + ELEMENT_FLAGS, width)
        self.match_in = nn.Linear(width, MATCH_KINDS * width, bias=False)  # of a goal token, for each kind of match
        self.goal_query = nn.Linear(width, width)
        self.goal_out = nn.Linear(2 * width, width)
        self.attention = Attention(width)
        self.group = nn.Linear(width, width)
        self.adjacent = nn.Linear(width, width) if config.adjacent_elements else None
        self.goal_pool = nn.Linear(width, 1)
        self.summary = nn.Linear(3 * width, width)

    def forward(self, batch: Batch) -> Encoding:
        batch = batch if self.config.goal_overlap else without_overlap(batch)
        tokens = self._encode_goal(batch)
        elements = self._encode_page(batch, tokens)
        summary = torch.relu(self.summary(self._pool(batch, tokens, elements)))
        return Encoding(batch, tokens, elements, batch.row, batch.real, batch.token_row, batch.token_mask, summary)

    def _encode_goal(self, batch: Batch) -> Tensor:
        """[T, D] the goal tokens in the context of the tokens around them. The rows between goals stay 0."""
        real = batch.token_real.unsqueeze(1).float()
        words = functional.embedding(batch.token_words, self.table)
        hidden = torch.relu(self.token_in(torch.cat([words, batch.token_flags], 1))) * real
        for conv in self.token_conv if self.config.word_order else ():
            window = torch.cat([hidden.roll(1, 0), hidden, hidden.roll(-1, 0)], dim=1)  # the last row is zeros
            hidden = hidden + torch.relu(conv(window)) * real
        return hidden

    def _encode_page(self, batch: Batch, tokens: Tensor) -> Tensor:
        """[N, D] the elements, with the goal tokens they match, attention to the goal, and the other elements."""
        text = functional.embedding_bag(batch.text_words, self.table, batch.text_first, mode="mean")
        kind = functional.embedding_bag(batch.kind_words, self.table, batch.kind_first, mode="mean")
        classes = functional.embedding_bag(batch.element_classes, self.classes.weight, mode="sum", padding_idx=0)
        own = torch.cat([text, kind, self.tag(batch.element_tag), classes, batch.element_flags], dim=1)
        matching = self.match_in(tokens).view(-1, tokens.shape[1])  # row MATCH_KINDS * token + kind
        matching = functional.embedding(batch.match_token, matching) * batch.match_weight.unsqueeze(1)
        hidden = torch.relu(self.element_in(own).index_add(0, batch.match_row, matching))
        goal = self._attend_to_goal(batch, hidden, tokens)
        hidden = hidden + torch.relu(self.goal_out(torch.cat([hidden, goal], dim=1)))
        out: Tensor = hidden + self.attention(hidden, batch) if self.config.element_attention else hidden
        out = out + torch.relu(self.group(self._group_maximum(batch, hidden)))
        if self.adjacent is not None:
            pairs = zip(adjacency(batch), batch.by_block(hidden), strict=True)
            near = [weights @ part for weights, part in pairs]
            out = out + torch.relu(self.adjacent(torch.cat([part.flatten(0, 1) for part in near])))
        return out

    def _group_maximum(self, batch: Batch, hidden: Tensor) -> Tensor:
        """[N, D] the maximum over the elements with the same `element_group`. `hidden` [N, D] is not negative."""
        group = batch.element_group.unsqueeze(1).expand_as(hidden)
        maximum = torch.full_like(hidden, -1.0).scatter_reduce(0, group, hidden, "amax")
        return functional.embedding(batch.element_group, maximum)

    def _attend_to_goal(self, batch: Batch, hidden: Tensor, tokens: Tensor) -> Tensor:
        """[N, D] the goal tokens, averaged with the attention weights of each element."""
        attended = []
        for block, query in zip(batch.blocks, batch.by_block(self.goal_query(hidden)), strict=True):
            words = functional.embedding(block.token_row, tokens).unsqueeze(1)
            bias = block.token_bias[:, None, None, :]
            mixed = functional.scaled_dot_product_attention(query.unsqueeze(1), words, words, attn_mask=bias)
            attended.append(mixed.flatten(0, 2))
        return torch.cat(attended)

    def _pool(self, batch: Batch, tokens: Tensor, elements: Tensor) -> Tensor:
        """[B, 3 * D] the attention-weighted mean of the goal tokens, and the mean and maximum of the elements."""
        scores = functional.embedding(batch.token_row, self.goal_pool(tokens)).squeeze(2)
        weights = scores.masked_fill(~batch.token_mask, MASKED_LOGIT).softmax(1)
        goal = torch.bmm(weights.unsqueeze(1), functional.embedding(batch.token_row, tokens)).squeeze(1)
        pooled = []
        for block, part in zip(batch.blocks, batch.by_block(elements), strict=True):
            if block.bias is None:
                mean = part.mean(1)
            else:
                real = (block.bias == 0).unsqueeze(2).float()
                part = part * real
                mean = part.sum(1) / real.sum(1).clamp(min=1)
            pooled.append(torch.cat([mean, part.amax(1)], dim=1))  # elements are not negative
        batch_order = torch.cat([block.pages for block in batch.blocks]).argsort()
        return torch.cat([goal, torch.cat(pooled).index_select(0, batch_order)], dim=1)


def adjacency(batch: Batch) -> list[Tensor]:
    """[b, E, E] for each block: the weights of each element over the other leaves of its page; 0 for non-leaves.

    A soft form of DOMNet's neighbours within some pixels (Liu et al. 2018). The weight falls with the distance between
    the edges of two boxes in pixels, and faster vertically, so most of it is on elements next to it in the same line.
    """
    page = torch.tensor([WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX], device=batch.element_flags.device)
    weights = []
    for block, box in zip(batch.blocks, batch.by_block(batch.element_flags[:, POSITION] * page), strict=True):
        size = box[:, :, 2:]
        centre = box[:, :, :2] + size / 2
        gap = (centre[:, :, None] - centre[:, None]).abs() - (size[:, :, None] + size[:, None]) / 2
        horizontal, vertical = gap.clamp(min=0).unbind(3)
        leaf = batch.clickable.index_select(0, block.pages)[:, : block.size]
        other = leaf[:, None, :] & ~torch.eye(block.size, dtype=torch.bool, device=box.device)
        scores = (-(horizontal + VERTICAL_WEIGHT * vertical) / ADJACENT_PX).masked_fill(~other, MASKED_LOGIT)
        weights.append(scores.softmax(2) * other)
    return weights


class _Lookup(torch.autograd.Function):
    """table[:, codes]: [H, ...] from table [H, V] and codes [...]. Its gradient is a histogram, which is faster.

    The gradient of indexing is slow when few codes are in many places.
    """

    @staticmethod
    def forward(ctx: Any, table: Tensor, codes: Tensor) -> Tensor:
        ctx.save_for_backward(codes)
        ctx.size = table.shape[1]
        found: Tensor = table.index_select(1, codes.flatten()).unflatten(1, codes.shape)
        return found

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None]:
        (codes,) = ctx.saved_tensors
        flat = codes.flatten()
        parts = [torch.bincount(flat, weights=part.flatten(), minlength=ctx.size) for part in grad]
        return torch.stack(parts).to(grad.dtype), None


def _look_up(table: Tensor, codes: Tensor) -> Tensor:
    found: Tensor = _Lookup.apply(table, codes)  # type: ignore[no-untyped-call]
    return found


class Attention(nn.Module):
    """Multi-head self-attention over the elements of each page (Vaswani et al. 2017).

    Each head adds a learned bias to the logits for each relation of two elements (Shaw et al. 2018).
    """

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.project = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.bias = nn.Parameter(torch.zeros(heads, RELATIONS))

    def forward(self, x: Tensor, batch: Batch) -> Tensor:
        """[N, D] from the flat elements [N, D]."""
        mixed = []
        bias = torch.cat([self.bias, self.bias.new_full((self.heads, 1), MASKED_LOGIT)], dim=1)
        for block, part in zip(batch.blocks, batch.by_block(self.project(x)), strict=True):
            q, k, v = part.unflatten(2, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).unbind(0)
            relation_bias = _look_up(bias, block.relations).transpose(0, 1)
            heads = functional.scaled_dot_product_attention(q, k, v, attn_mask=relation_bias)
            mixed.append(heads.transpose(1, 2).flatten(2).flatten(0, 1))
        return torch.relu(self.out(torch.cat(mixed)))
