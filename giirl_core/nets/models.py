"""The policy net and the reward net. Each has its own encoder."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import NetConfig
from giirl_core.nets.action_batch import ActionBatch
from giirl_core.nets.batch import MASKED_LOGIT, Batch
from giirl_core.nets.encoder import Encoder, Encoding
from giirl_core.nets.language import Vectors
from giirl_core.types import LEARNABLE_VERBS, NO_SPAN, Verb

VERBS = len(LEARNABLE_VERBS)  # the nets learn only CLICK and TYPE, which have the numbers 0 and 1


class PolicyNet(nn.Module):
    """pi_theta(a | s, g) and V(s, g), as a pointer network over the elements of a page and the tokens of a goal.

    An action is sampled in three parts: the pair (element, verb), then, for TYPE, the first and the last goal token to
    type. A page is encoded once, `encoding = net.encoder(batch)`. Any number of actions on it can then be sampled and
    evaluated.
    """

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.pair_head = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, VERBS))
        self.start_query = nn.Linear(2 * width, width)
        self.end_query = nn.Linear(2 * width, width)
        self.value_head = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))

    @property
    def device(self) -> torch.device:
        """The device of the parameters."""
        return self.encoder.table.device

    def pair_logp(self, encoding: Encoding) -> Tensor:
        """[B, E * verbs] log-probabilities of (element, verb) pairs: click a leaf, or type into a field."""
        batch = encoding.batch
        first, last = self.pair_head[0], self.pair_head[2]
        assert isinstance(first, nn.Linear)
        weight, bias = first.weight, first.bias
        width = encoding.elements.shape[1]
        # first(cat[element, summary]), with the part of the summary computed only once for each page
        shared = functional.linear(encoding.summary, weight[:, width:])
        hidden = functional.linear(encoding.elements, weight[:, :width], bias)
        hidden = torch.relu(hidden + functional.embedding(batch.element_page, shared))
        logits = functional.embedding(batch.row, last(hidden))
        legal = torch.stack([batch.clickable, batch.typable], dim=2)
        out: Tensor = logits.masked_fill(~legal, MASKED_LOGIT).flatten(1).log_softmax(1)
        return out

    def start_logp(self, encoding: Encoding, element: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the first token to type into the fields `element` [B, M]."""
        field = encoding.element(element)
        query = self.start_query(torch.cat([field, encoding.summary.unsqueeze(1).expand_as(field)], dim=2))
        return _pointer_logp(query, encoding.goal_tokens, encoding.token_mask.unsqueeze(1))

    def end_logp(self, encoding: Encoding, element: Tensor, start: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the last token, which is not before the first one, `start` [B, M]."""
        query = self.end_query(torch.cat([encoding.element(element), encoding.token(start)], dim=2))
        after = torch.arange(encoding.token_mask.shape[1], device=start.device) >= start.unsqueeze(2)
        return _pointer_logp(query, encoding.goal_tokens, encoding.token_mask.unsqueeze(1) & after)

    def sample(self, encoding: Encoding, uniform: Tensor | None) -> tuple[ActionBatch, Tensor]:
        """M actions for each page, and their log-probabilities [B, M], nats.

        `uniform` [B, M, 3] in [0, 1) holds the random numbers. With None, the result is the greedy action (M = 1): the
        most probable pair, then the most probable first token, then the most probable last token.
        """
        u_pair, u_start, u_end = (None, None, None) if uniform is None else uniform.unbind(2)
        pairs = self.pair_logp(encoding)
        pair = pairs.argmax(1, keepdim=True) if u_pair is None else sample_categorical(pairs, u_pair)
        verb, element = pair % VERBS, pair // VERBS
        logp, typing = pairs.gather(1, pair), verb == Verb.TYPE
        start = end = torch.full_like(pair, NO_SPAN)
        pages = typing.any(1).nonzero().squeeze(1)
        if len(pages):
            subset, element, typed = encoding.select(pages), element[pages], typing[pages]
            starts = self.start_logp(subset, element)
            first = starts.argmax(2) if u_start is None else _sample_each(starts, u_start[pages])
            ends = self.end_logp(subset, element, first)
            last = ends.argmax(2) if u_end is None else _sample_each(ends, u_end[pages])
            logp = logp.index_add(0, pages, torch.where(typed, _at(starts, first) + _at(ends, last), 0.0))
            start = start.index_copy(0, pages, torch.where(typed, first, NO_SPAN))
            end = end.index_copy(0, pages, torch.where(typed, last, NO_SPAN))
        return ActionBatch(verb=verb, element=pair // VERBS, start=start, end=end), logp

    def evaluate(self, encoding: Encoding, actions: ActionBatch) -> tuple[Tensor, Tensor]:
        """log pi(a | s, g) [B, M] and the entropy of pi(. | s, g) [B], nats.

        The entropy is that of the (element, verb) pair. If the first action types, the entropies of its first and last
        token are added, given the element (and the first token) of that action.
        """
        pairs = self.pair_logp(encoding)
        logp, entropy = pairs.gather(1, actions.element * VERBS + actions.verb), _entropy(pairs)
        typing = actions.verb == Verb.TYPE
        pages = typing.any(1).nonzero().squeeze(1)
        if len(pages):
            subset, element, typed = encoding.select(pages), actions.element[pages], typing[pages]
            start, end = actions.start[pages].clamp(min=0), actions.end[pages].clamp(min=0)
            starts = self.start_logp(subset, element)
            ends = self.end_logp(subset, element, start)
            logp = logp.index_add(0, pages, torch.where(typed, _at(starts, start) + _at(ends, end), 0.0))
            span_entropy = torch.where(typed[:, 0], _entropy(starts[:, 0]) + _entropy(ends[:, 0]), 0.0)
            entropy = entropy.index_add(0, pages, span_entropy)
        return logp, entropy

    def state_value(self, encoding: Encoding) -> Tensor:
        """V(s, g) [B]."""
        value: Tensor = self.value_head(encoding.summary).squeeze(1)
        return value


class RewardNet(nn.Module):
    """The logit of D_phi(s, a | g), log D - log(1 - D)."""

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.verb = nn.Embedding(VERBS, 16)
        # In place of the first and last token: row 0 if nothing is typed, row 1 if the goal lacks the typed text.
        self.absent = nn.Parameter(torch.zeros(2, width))
        self.head = nn.Sequential(nn.Linear(4 * width + 16, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """[B, M] logits of M actions on each page."""
        out: Tensor = self.head(self.encode(self.encoder(batch), actions)).squeeze(2)
        return out

    def encode(self, encoding: Encoding, actions: ActionBatch) -> Tensor:
        """[B, M, 4 * D + 16] the inputs of `head`: element, summary, first and last token, and verb of each action."""
        in_goal = (actions.start >= 0).unsqueeze(2)
        absent = functional.embedding((actions.verb == Verb.TYPE).long(), self.absent)
        element = encoding.element(actions.element)
        first, last = absent, absent
        if bool(in_goal.any()):
            first = torch.where(in_goal, encoding.token(actions.start.clamp(min=0)), absent)
            last = torch.where(in_goal, encoding.token(actions.end.clamp(min=0)), absent)
        summary = encoding.summary.unsqueeze(1).expand_as(element)
        return torch.cat([element, summary, first, last, self.verb(actions.verb)], dim=2)


def sample_categorical(logp: Tensor, uniform: Tensor) -> Tensor:
    """[..., M] column indices sampled from log-probabilities [..., C], by inverting the cumulative distribution.

    `uniform` [..., M] in [0, 1) holds the random numbers.
    """
    index = torch.searchsorted(logp.exp().cumsum(-1), uniform.contiguous(), right=True)
    legal = (logp > MASKED_LOGIT / 2).long()
    last_legal = logp.shape[-1] - 1 - legal.flip(-1).argmax(-1, keepdim=True)
    return torch.minimum(index, last_legal)  # through rounding, the sum of all probabilities may stay below `uniform`


def _sample_each(logp: Tensor, uniform: Tensor) -> Tensor:
    """[B, M] one index for each of B x M distributions [B, M, C]."""
    return sample_categorical(logp, uniform.unsqueeze(2)).squeeze(2)


def _at(logp: Tensor, index: Tensor) -> Tensor:
    """[B, M] logp[b, m, index[b, m]]."""
    return logp.gather(2, index.unsqueeze(2)).squeeze(2)


def _pointer_logp(query: Tensor, keys: Tensor, mask: Tensor) -> Tensor:
    """[B, M, L] log-probabilities of pointing at the keys [B, L, D] with the queries [B, M, D]."""
    scores = torch.bmm(query, keys.transpose(1, 2)) / query.shape[2] ** 0.5
    logp: Tensor = scores.masked_fill(~mask, MASKED_LOGIT).log_softmax(2)
    return logp


def _entropy(logp: Tensor) -> Tensor:
    """[B] the entropy of log-probabilities [B, C], nats."""
    entropy: Tensor = -(logp.exp() * logp).sum(1)
    return entropy
