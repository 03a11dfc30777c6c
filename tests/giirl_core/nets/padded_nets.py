"""Reference implementation of the nets, for tests: plain code on padded tables [B, E, ...].

The nets of `giirl_core.nets` must give the same losses and gradients. Parameters have the same names in both.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import NetConfig
from giirl_core.gestures import BASIC
from giirl_core.nets import layout
from giirl_core.nets.action_batch import ActionBatch
from giirl_core.nets.language import PADDING, Vectors
from giirl_core.types import NO_SPAN, Verb
from tests.giirl_core.nets.padded_features import Batch, without_overlap

GESTURES = len(BASIC)  # to click and to type words, which have the numbers of CLICK and TYPE
MASKED_LOGIT = -1e9  # of illegal or padded choices
ADJACENT_PX = 4.0  # the distance at which the weight of an adjacent element falls to 1 / e
VERTICAL_WEIGHT = 3.0  # a vertical pixel counts as this many horizontal ones


@dataclass(frozen=True, slots=True)
class Encoding:
    """B encoded pages."""

    tokens: Tensor  # [B, L, D]
    elements: Tensor  # [B, E, D]
    summary: Tensor  # [B, D] of goal and page together


class Encoder(nn.Module):
    """Encodes goal tokens and page elements with `config.width` units each."""

    table: Tensor

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        self.config, width = config, config.width
        self.register_buffer("table", torch.from_numpy(vectors.table), persistent=False)
        words = self.table.shape[1]
        self.token_in = nn.Linear(words + layout.TOKEN_FLAGS, width)
        self.token_conv = nn.ModuleList(nn.Linear(3 * width, width) for _ in range(2))
        self.tag = nn.Embedding(layout.TAGS, 16)
        self.classes = nn.Embedding(layout.CLASSES, 8, padding_idx=0)
        self.element_in = nn.Linear(2 * words + 16 + 8 + layout.ELEMENT_FLAGS, width)
        self.match_in = nn.Linear(width, layout.MATCH_KINDS * width, bias=False)
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
        weights = self.goal_pool(tokens).squeeze(2).masked_fill(~batch.token_mask, MASKED_LOGIT).softmax(1)
        goal = torch.einsum("bl,bld->bd", weights, tokens)
        real = batch.element_mask.unsqueeze(2)
        mean = (elements * real).sum(1) / real.sum(1).clamp(min=1)
        maximum = (elements * real).amax(1)  # elements are not negative
        summary = torch.relu(self.summary(torch.cat([goal, mean, maximum], dim=1)))
        return Encoding(tokens, elements, summary)

    def _encode_goal(self, batch: Batch) -> Tensor:
        """[B, L, D] the goal tokens in the context of the tokens around them."""
        mask = batch.token_mask.unsqueeze(2)
        hidden = torch.relu(self.token_in(torch.cat([self.table[batch.token_words], batch.token_flags], 2)))
        for conv in self.token_conv if self.config.word_order else ():
            hidden = hidden * mask
            assert isinstance(conv, nn.Linear)
            kernel = conv.weight.unflatten(1, (3, -1)).mT
            hidden = hidden + torch.relu(functional.conv1d(hidden.transpose(1, 2), kernel, conv.bias, padding=1).mT)
        return hidden * mask

    def _encode_page(self, batch: Batch, tokens: Tensor) -> Tensor:
        """[B, E, D] the elements, with the goal tokens they match, attention to the goal, and the other elements."""
        text, kind = self._mean_words(batch.element_words), self._mean_words(batch.element_kind)
        weight = self.match_in.weight.unflatten(0, (layout.MATCH_KINDS, -1))
        matching = torch.einsum("bkel,bld,kcd->bec", batch.matches, tokens, weight)
        classes = self.classes(batch.element_classes).sum(2)
        parts = [text, kind, self.tag(batch.element_tag), classes, batch.element_flags]
        hidden = torch.relu(self.element_in(torch.cat(parts, dim=2)) + matching)
        weights = torch.einsum("bed,bld->bel", self.goal_query(hidden), tokens) / hidden.shape[2] ** 0.5
        weights = weights.masked_fill(~batch.token_mask.unsqueeze(1), MASKED_LOGIT).softmax(2)
        goal = torch.einsum("bel,bld->bed", weights, tokens)
        hidden = hidden + torch.relu(self.goal_out(torch.cat([hidden, goal], dim=2)))
        out: Tensor = hidden + self.attention(hidden, batch) if self.config.element_attention else hidden
        members = hidden.unsqueeze(1).masked_fill(~batch.same_group.unsqueeze(3), -1.0)  # [B, E, E, D]
        out = out + torch.relu(self.group(members.amax(2).clamp(min=0)))
        if self.adjacent is not None:
            out = out + torch.relu(self.adjacent(torch.einsum("bij,bjd->bid", adjacency(batch), hidden)))
        return out

    def _mean_words(self, rows: Tensor) -> Tensor:
        """[B, E, D] the mean of the word vectors with the rows [B, E, W], without padding."""
        count = (rows != PADDING).sum(2, keepdim=True).clamp(min=1)
        mean: Tensor = self.table[rows].sum(2) / count
        return mean


def adjacency(batch: Batch) -> Tensor:
    """[B, E, E] the weights of each element over the other leaves of its page, by distance in pixels; 0 for others."""
    box = batch.element_flags[:, :, layout.POSITION] * torch.tensor(
        [layout.WIDTH_PX, layout.HEIGHT_PX, layout.WIDTH_PX, layout.HEIGHT_PX]
    )
    size = box[:, :, 2:]
    centre = box[:, :, :2] + size / 2
    gap = (centre[:, :, None] - centre[:, None]).abs() - (size[:, :, None] + size[:, None]) / 2
    horizontal, vertical = gap.clamp(min=0).unbind(3)
    other = batch.clickable[:, None, :] & ~torch.eye(box.shape[1], dtype=torch.bool)
    scores = (-(horizontal + VERTICAL_WEIGHT * vertical) / ADJACENT_PX).masked_fill(~other, MASKED_LOGIT)
    return scores.softmax(2) * other


class Attention(nn.Module):
    """Multi-head self-attention over the elements of each page."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.project = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.bias = nn.Parameter(torch.zeros(heads, layout.RELATIONS))

    def forward(self, x: Tensor, batch: Batch) -> Tensor:
        size, count, width = x.shape
        q, k, v = self.project(x).view(size, count, 3, self.heads, -1).unbind(2)
        scores = torch.einsum("bihd,bjhd->bhij", q, k) / (width // self.heads) ** 0.5
        scores = scores + self.bias[:, batch.relations].transpose(0, 1)
        weights = scores.masked_fill(~batch.element_mask[:, None, None, :], MASKED_LOGIT).softmax(3)
        mixed = torch.einsum("bhij,bjhd->bihd", weights, v).reshape(size, count, width)
        out: Tensor = torch.relu(self.out(mixed))
        return out


class PolicyNet(nn.Module):
    """pi_theta(a | s, g) and V(s, g), for M actions on each of B pages."""

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.pair_head = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, GESTURES))
        self.start_query = nn.Linear(2 * width, width)
        self.end_query = nn.Linear(2 * width, width)
        self.value_head = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))

    def _pair_logp(self, batch: Batch, encoding: Encoding) -> Tensor:
        """[B, E * verbs] log-probabilities of (element, verb) pairs: click a leaf, or type into a field."""
        summary = encoding.summary.unsqueeze(1).expand_as(encoding.elements)
        logits = self.pair_head(torch.cat([encoding.elements, summary], dim=2))
        legal = torch.stack([batch.clickable, batch.typable], dim=2)
        out: Tensor = logits.masked_fill(~legal, MASKED_LOGIT).flatten(1).log_softmax(1)
        return out

    def _start_logp(self, batch: Batch, encoding: Encoding, element: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the first token to type into the fields `element` [B, M]."""
        field = _pick(encoding.elements, element)
        query = self.start_query(torch.cat([field, encoding.summary.unsqueeze(1).expand_as(field)], dim=2))
        return _pointer_logp(query, encoding.tokens, batch.token_mask.unsqueeze(1))

    def _end_logp(self, batch: Batch, encoding: Encoding, element: Tensor, start: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the last token, which is not before the first one, `start` [B, M]."""
        query = self.end_query(torch.cat([_pick(encoding.elements, element), _pick(encoding.tokens, start)], dim=2))
        after = torch.arange(batch.token_mask.shape[1]) >= start.unsqueeze(2)
        return _pointer_logp(query, encoding.tokens, batch.token_mask.unsqueeze(1) & after)

    def sample(self, batch: Batch, uniform: Tensor | None, flat: Tensor | None = None) -> tuple[ActionBatch, Tensor]:
        """M actions for each page, and their log-probabilities [B, M], nats, under the distribution they come from.

        `uniform` [B, M, 3] in [0, 1) holds the random numbers; None selects the greedy action. Where `flat` [M] is
        True, the action is uniform over the legal ones instead of from the policy.
        """
        encoding: Encoding = self.encoder(batch)
        parts = (None, None, None) if uniform is None else uniform.unbind(2)
        count = 1 if uniform is None else uniform.shape[1]
        pairs = _flatten(self._pair_logp(batch, encoding).unsqueeze(1).expand(-1, count, -1), flat)
        pair = _sample_categorical(pairs, parts[0])
        verb, element = pair % GESTURES, pair // GESTURES
        starts = _flatten(self._start_logp(batch, encoding, element), flat)
        start = _sample_categorical(starts, parts[1])
        ends = _flatten(self._end_logp(batch, encoding, element, start), flat)
        end = _sample_categorical(ends, parts[2])
        typing = verb == Verb.TYPE
        logp = _at(pairs, pair) + torch.where(typing, _at(starts, start) + _at(ends, end), 0.0)
        none = torch.full_like(start, NO_SPAN)
        actions = ActionBatch(
            gesture=verb,
            element=element,
            start=torch.where(typing, start, none),
            end=torch.where(typing, end, none),
        )
        return actions, logp

    def evaluate(self, batch: Batch, actions: ActionBatch) -> tuple[Tensor, Tensor, Tensor]:
        """log pi(a | s, g) [B, M] and the entropy of pi(. | s, g) [B], nats, and V(s, g) [B].

        If the first action types, the entropy includes those of its first and last token.
        """
        encoding: Encoding = self.encoder(batch)
        pairs = self._pair_logp(batch, encoding)
        typing = actions.gesture == Verb.TYPE
        start, end = actions.start.clamp(min=0), actions.end.clamp(min=0)
        starts = self._start_logp(batch, encoding, actions.element)
        ends = self._end_logp(batch, encoding, actions.element, start)
        logp = pairs.gather(1, actions.element * GESTURES + actions.gesture)
        logp = logp + torch.where(typing, _at(starts, start) + _at(ends, end), 0.0)
        span_entropy = torch.where(typing[:, 0], _entropy(starts[:, 0]) + _entropy(ends[:, 0]), 0.0)
        value: Tensor = self.value_head(encoding.summary).squeeze(1)
        return logp, _entropy(pairs) + span_entropy, value

    def value_of(self, batch: Batch) -> Tensor:
        """V(s, g) [B]."""
        encoding: Encoding = self.encoder(batch)
        value: Tensor = self.value_head(encoding.summary).squeeze(1)
        return value


class RewardNet(nn.Module):
    """The logit of D_phi(s, a | g), log D - log(1 - D)."""

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.gesture = nn.Embedding(GESTURES, 16)
        self.absent = nn.Parameter(torch.zeros(2, width))  # nothing is typed; the goal lacks the typed text
        self.head = nn.Sequential(nn.Linear(4 * width + 16, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """[B, M] logits of M actions on each page."""
        out: Tensor = self.head(self.encode(batch, actions)).squeeze(2)
        return out

    def encode(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """[B, M, 4 * D + 16] the inputs of `head`: element, summary, first and last token, and verb of each action."""
        encoding: Encoding = self.encoder(batch)
        first = _pick(encoding.tokens, actions.start.clamp(min=0))
        last = _pick(encoding.tokens, actions.end.clamp(min=0))
        absent = self.absent[(actions.gesture == Verb.TYPE).long()]
        in_goal = (actions.start >= 0).unsqueeze(2)
        parts = [
            _pick(encoding.elements, actions.element),
            encoding.summary.unsqueeze(1).expand_as(first),
            torch.where(in_goal, first, absent),
            torch.where(in_goal, last, absent),
            self.gesture(actions.gesture),
        ]
        return torch.cat(parts, dim=2)


def _pick(x: Tensor, index: Tensor) -> Tensor:
    """[B, M, D] x[b, index[b, m]] from x [B, N, D]."""
    picked: Tensor = x[torch.arange(len(index)).unsqueeze(1), index]
    return picked


def _at(logp: Tensor, index: Tensor) -> Tensor:
    """[B, M] logp[b, m, index[b, m]]."""
    return logp.gather(2, index.unsqueeze(2)).squeeze(2)


def _pointer_logp(query: Tensor, keys: Tensor, mask: Tensor) -> Tensor:
    """[B, M, L] log-probabilities of pointing at the keys [B, L, D] with the queries [B, M, D]."""
    scores = torch.einsum("bmd,bld->bml", query, keys) / query.shape[2] ** 0.5
    logp: Tensor = scores.masked_fill(~mask, MASKED_LOGIT).log_softmax(2)
    return logp


def _flatten(logp: Tensor, flat: Tensor | None) -> Tensor:
    """The same distributions, but uniform over the legal choices where `flat` [M] is True."""
    if flat is None:
        return logp
    return torch.where(flat.unsqueeze(1) & (logp > MASKED_LOGIT / 2), 0.0, logp).log_softmax(2)


def _sample_categorical(logp: Tensor, uniform: Tensor | None) -> Tensor:
    """[B, M] columns sampled with the random numbers `uniform` [B, M]; the most probable ones with None."""
    if uniform is None:
        return logp.argmax(2)
    passed = logp.exp().cumsum(2) <= uniform.unsqueeze(2)  # also skips illegal columns if `uniform` is 0
    legal = (logp > MASKED_LOGIT / 2).long()
    last = logp.shape[2] - 1 - legal.flip(2).argmax(2)
    return torch.minimum(passed.sum(2), last)


def _entropy(logp: Tensor) -> Tensor:
    """[B] the entropy of log-probabilities [B, C], nats."""
    entropy: Tensor = -(logp.exp() * logp).sum(1)
    return entropy
