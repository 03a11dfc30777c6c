"""The nets: a goal encoder and a page encoder after DOMNet (Liu et al. 2018), a pointer policy, a reward."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import NetConfig
from giirl_core.nets.language import PADDING, Vectors
from giirl_core.types import LEARNABLE_VERBS, NO_SPAN, Verb
from tests.giirl_core.nets.padded_features import (
    CLASSES,
    ELEMENT_FLAGS,
    HEIGHT_PX,
    POSITION,
    TAGS,
    TOKEN_FLAGS,
    WIDTH_PX,
    ActionBatch,
    Batch,
    without_overlap,
)

VERBS = len(LEARNABLE_VERBS)  # CLICK and TYPE, which are 0 and 1: the nets go on learning these alone
MASKED_LOGIT = -1e9  # the logit of what may not be chosen
BESIDE_PX = 4.0  # what stands further away counts e times less
LINES_APART = 3.0  # how much more a pixel up or down counts than one to the side


@dataclass(frozen=True, slots=True)
class Encoding:
    """B pages read under their goals."""

    tokens: Tensor  # [B, L, D]
    elements: Tensor  # [B, E, D]
    summary: Tensor  # [B, D] goal and page together


class Encoder(nn.Module):
    """Goal tokens and page elements in one space of `width`, elements aligned with the goal and each other."""

    table: Tensor

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        self.config, width = config, config.width
        self.register_buffer("table", torch.from_numpy(vectors.table), persistent=False)
        words = self.table.shape[1]
        self.token_in = nn.Linear(words + TOKEN_FLAGS, width)
        self.token_conv = nn.ModuleList(nn.Linear(3 * width, width) for _ in range(2))
        self.tag = nn.Embedding(TAGS, 16)
        self.classes = nn.Embedding(CLASSES, 8, padding_idx=0)
        self.element_in = nn.Linear(words + 16 + 8 + ELEMENT_FLAGS + 3 * width, width)
        self.align = nn.Linear(width, width)
        self.aligned = nn.Linear(2 * width, width)
        self.neighbours = Attention(width)
        self.beside = nn.Linear(width, width) if config.adjacent_elements else None
        self.goal_pool = nn.Linear(width, 1)
        self.summary = nn.Linear(3 * width, width)

    def forward(self, batch: Batch) -> Encoding:
        batch = batch if self.config.goal_overlap else without_overlap(batch)
        tokens = self._read_goal(batch)
        elements = self._read_page(batch, tokens)
        weights = self.goal_pool(tokens).squeeze(2).masked_fill(~batch.token_mask, MASKED_LOGIT).softmax(1)
        goal = torch.einsum("bl,bld->bd", weights, tokens)
        real = batch.element_mask.unsqueeze(2)
        mean = (elements * real).sum(1) / real.sum(1).clamp(min=1)
        peak = (elements * real).amax(1)  # elements are not negative
        summary = torch.relu(self.summary(torch.cat([goal, mean, peak], dim=1)))
        return Encoding(tokens, elements, summary)

    def _read_goal(self, batch: Batch) -> Tensor:
        """[B, L, D]: each word in the light of its neighbours."""
        mask = batch.token_mask.unsqueeze(2)
        hidden = torch.relu(self.token_in(torch.cat([self.table[batch.token_words], batch.token_flags], 2)))
        for conv in self.token_conv if self.config.word_order else ():
            hidden = hidden * mask
            kernel = conv.weight.unflatten(1, (3, -1)).transpose(1, 2)
            hidden = hidden + torch.relu(functional.conv1d(hidden.transpose(1, 2), kernel, conv.bias, padding=1).mT)
        return hidden * mask

    def _read_page(self, batch: Batch, tokens: Tensor) -> Tensor:
        """[B, E, D]: each element with the words of the goal it repeats, the ones it resembles, and its neighbours."""
        read = (batch.element_words != PADDING).sum(2, keepdim=True).clamp(min=1)
        text = self.table[batch.element_words].sum(2) / read
        repeated = torch.einsum("bkel,bld->bekd", batch.matches, tokens).flatten(2)
        classes = self.classes(batch.element_classes).sum(2)
        parts = [text, self.tag(batch.element_tag), classes, batch.element_flags, repeated]
        hidden = torch.relu(self.element_in(torch.cat(parts, dim=2)))
        likeness = torch.einsum("bed,bld->bel", self.align(hidden), tokens) / hidden.shape[2] ** 0.5
        likeness = likeness.masked_fill(~batch.token_mask.unsqueeze(1), MASKED_LOGIT).softmax(2)
        alignment = torch.einsum("bel,bld->bed", likeness, tokens)
        hidden = hidden + torch.relu(self.aligned(torch.cat([hidden, alignment], dim=2)))
        out: Tensor = hidden + self.neighbours(hidden, batch.element_mask) if self.config.element_attention else hidden
        if self.beside is not None:
            out = out + torch.relu(self.beside(torch.einsum("bij,bjd->bid", nearness(batch), hidden)))
        return out


def nearness(batch: Batch) -> Tensor:
    """[B, E, E] for each element its leaves by pixel distance: shares of those other than itself, 0 of others.

    DOMNet's neighbours in pixels (Liu et al. 2018) in a soft form: most of the weight is on what is beside it in its
    line, where lines are some px apart, edge to edge.
    """
    box = batch.element_flags[:, :, POSITION] * torch.tensor([WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX])
    size = box[:, :, 2:]
    centre = box[:, :, :2] + size / 2
    gap = (centre[:, :, None] - centre[:, None]).abs() - (size[:, :, None] + size[:, None]) / 2
    across, down = gap.clamp(min=0).unbind(3)
    other = batch.clickable[:, None, :] & ~torch.eye(box.shape[1], dtype=torch.bool)
    scores = (-(across + LINES_APART * down) / BESIDE_PX).masked_fill(~other, MASKED_LOGIT)
    return scores.softmax(2) * other


class Attention(nn.Module):
    """Four heads from every element to every element: what stands beside what."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.project = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)

    def forward(self, x: Tensor, mask: Tensor) -> Tensor:
        size, count, width = x.shape
        q, k, v = self.project(x).view(size, count, 3, self.heads, -1).unbind(2)
        scores = torch.einsum("bihd,bjhd->bhij", q, k) / (width // self.heads) ** 0.5
        weights = scores.masked_fill(~mask[:, None, None, :], MASKED_LOGIT).softmax(3)
        mixed = torch.einsum("bhij,bjhd->bihd", weights, v).reshape(size, count, width)
        out: Tensor = torch.relu(self.out(mixed))
        return out


class PolicyNet(nn.Module):
    """pi_theta(a | s, g): a pointer over (element, verb), then over the first and last word to copy; and V(s, g).

    Every page may be asked about M actions at once; [B, M] below.
    """

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.act = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, VERBS))
        self.start = nn.Linear(2 * width, width)
        self.end = nn.Linear(2 * width, width)
        self.value = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))

    def _pairs(self, batch: Batch, seen: Encoding) -> Tensor:
        """[B, E * verbs] log-probabilities of (element, verb) pairs; click needs a leaf, type a field."""
        summary = seen.summary.unsqueeze(1).expand_as(seen.elements)
        logits = self.act(torch.cat([seen.elements, summary], dim=2))
        legal = torch.stack([batch.clickable, batch.typable], dim=2)
        out: Tensor = logits.masked_fill(~legal, MASKED_LOGIT).flatten(1).log_softmax(1)
        return out

    def _starts(self, batch: Batch, seen: Encoding, element: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the first word, given the field that takes it."""
        field = _pick(seen.elements, element)
        query = self.start(torch.cat([field, seen.summary.unsqueeze(1).expand_as(field)], dim=2))
        return _point(query, seen.tokens, batch.token_mask.unsqueeze(1))

    def _ends(self, batch: Batch, seen: Encoding, element: Tensor, start: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the last word, which is not before the first."""
        query = self.end(torch.cat([_pick(seen.elements, element), _pick(seen.tokens, start)], dim=2))
        after = torch.arange(batch.token_mask.shape[1]) >= start.unsqueeze(2)
        return _point(query, seen.tokens, batch.token_mask.unsqueeze(1) & after)

    def sample(self, batch: Batch, uniform: Tensor | None, flat: Tensor | None = None) -> tuple[ActionBatch, Tensor]:
        """M actions for each page and their log-probabilities [B, M] under what they were drawn from.

        `uniform` [B, M, 3] in [0, 1) drives the draws; None takes the one likeliest action. Where `flat` [M]
        is True the draw is uniform over what is legal instead of by the policy.
        """
        seen: Encoding = self.encoder(batch)
        draws = (None, None, None) if uniform is None else uniform.unbind(2)
        count = 1 if uniform is None else uniform.shape[1]
        pairs = _flatten(self._pairs(batch, seen).unsqueeze(1).expand(-1, count, -1), flat)
        pair = _draw(pairs, draws[0])
        verb, element = pair % VERBS, pair // VERBS
        starts = _flatten(self._starts(batch, seen, element), flat)
        start = _draw(starts, draws[1])
        ends = _flatten(self._ends(batch, seen, element, start), flat)
        end = _draw(ends, draws[2])
        typing = verb == Verb.TYPE
        logp = _at(pairs, pair) + torch.where(typing, _at(starts, start) + _at(ends, end), 0.0)
        none = torch.full_like(start, NO_SPAN)
        actions = ActionBatch(
            verb=verb,
            element=element,
            start=torch.where(typing, start, none),
            end=torch.where(typing, end, none),
        )
        return actions, logp

    def evaluate(self, batch: Batch, actions: ActionBatch) -> tuple[Tensor, Tensor, Tensor]:
        """log pi(a | s, g) [B, M] in nats, the entropy of pi(. | s, g) [B] in nats, and V(s, g) [B].

        The entropy of the copied words is that at the field of the first action, if it types.
        """
        seen: Encoding = self.encoder(batch)
        pairs = self._pairs(batch, seen)
        typing = actions.verb == Verb.TYPE
        start, end = actions.start.clamp(min=0), actions.end.clamp(min=0)
        starts = self._starts(batch, seen, actions.element)
        ends = self._ends(batch, seen, actions.element, start)
        logp = pairs.gather(1, actions.element * VERBS + actions.verb)
        logp = logp + torch.where(typing, _at(starts, start) + _at(ends, end), 0.0)
        copied = torch.where(typing[:, 0], _entropy(starts[:, 0]) + _entropy(ends[:, 0]), 0.0)
        value: Tensor = self.value(seen.summary).squeeze(1)
        return logp, _entropy(pairs) + copied, value

    def value_of(self, batch: Batch) -> Tensor:
        """V(s, g) [B]."""
        seen: Encoding = self.encoder(batch)
        value: Tensor = self.value(seen.summary).squeeze(1)
        return value


class RewardNet(nn.Module):
    """The logit of D_phi(s, a | g): the policy's reading of the page, with the action marked, ending in one number."""

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.verb = nn.Embedding(VERBS, 16)
        self.absent = nn.Parameter(torch.zeros(2, width))  # nothing typed; typed words that the goal lacks
        self.head = nn.Sequential(nn.Linear(4 * width + 16, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """[B, M] logits, log D - log(1 - D), of M actions on each page."""
        out: Tensor = self.head(self.encode(batch, actions)).squeeze(2)
        return out

    def encode(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """[B, M, 4 * width + 16]: the action's element, the page and goal, the words copied, the verb."""
        seen: Encoding = self.encoder(batch)
        first = _pick(seen.tokens, actions.start.clamp(min=0))
        last = _pick(seen.tokens, actions.end.clamp(min=0))
        absent = self.absent[(actions.verb == Verb.TYPE).long()]
        copied = (actions.start >= 0).unsqueeze(2)
        parts = [
            _pick(seen.elements, actions.element),
            seen.summary.unsqueeze(1).expand_as(first),
            torch.where(copied, first, absent),
            torch.where(copied, last, absent),
            self.verb(actions.verb),
        ]
        return torch.cat(parts, dim=2)


def _pick(x: Tensor, index: Tensor) -> Tensor:
    """[B, M, D]: x[b, index[b, m]] from x [B, N, D]."""
    picked: Tensor = x[torch.arange(len(index)).unsqueeze(1), index]
    return picked


def _at(logp: Tensor, index: Tensor) -> Tensor:
    """[B, M]: logp[b, m, index[b, m]]."""
    return logp.gather(2, index.unsqueeze(2)).squeeze(2)


def _point(query: Tensor, keys: Tensor, mask: Tensor) -> Tensor:
    """[B, M, L] log-probabilities of the keys [B, L, D] under the queries [B, M, D]."""
    scores = torch.einsum("bmd,bld->bml", query, keys) / query.shape[2] ** 0.5
    logp: Tensor = scores.masked_fill(~mask, MASKED_LOGIT).log_softmax(2)
    return logp


def _flatten(logp: Tensor, flat: Tensor | None) -> Tensor:
    """The same distribution, but uniform over what is legal where `flat` [M] is True."""
    if flat is None:
        return logp
    return torch.where(flat.unsqueeze(1) & (logp > MASKED_LOGIT / 2), 0.0, logp).log_softmax(2)


def _draw(logp: Tensor, uniform: Tensor | None) -> Tensor:
    """[B, M] the likeliest column, or the one where the cumulative probability passes `uniform` [B, M]."""
    if uniform is None:
        return logp.argmax(2)
    passed = logp.exp().cumsum(2) <= uniform.unsqueeze(2)  # a draw of exactly 0 passes what may not be chosen
    legal = (logp > MASKED_LOGIT / 2).long()
    last = logp.shape[2] - 1 - legal.flip(2).argmax(2)
    return torch.minimum(passed.sum(2), last)


def _entropy(logp: Tensor) -> Tensor:
    """Over the last axis, nats."""
    entropy: Tensor = -(logp.exp() * logp).sum(1)
    return entropy
