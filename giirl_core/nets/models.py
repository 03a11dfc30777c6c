"""The nets: a pointer policy and a reward, each with an encoder of its own."""

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

VERBS = len(LEARNABLE_VERBS)  # CLICK and TYPE, which are 0 and 1: the nets learn these alone


class PolicyNet(nn.Module):
    """pi_theta(a | s, g): a pointer over (element, verb), then over the first and last word to copy; and V(s, g).

    A page is encoded once, `seen = net.encoder(batch)`; then any number of actions can be drawn or evaluated on it.
    """

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.act = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, VERBS))
        self.start = nn.Linear(2 * width, width)
        self.end = nn.Linear(2 * width, width)
        self.value = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))

    @property
    def device(self) -> torch.device:
        """Where the net computes."""
        return self.encoder.table.device

    def pairs(self, seen: Encoding) -> Tensor:
        """[B, E * verbs] log-probabilities of (element, verb) pairs; click needs a leaf, type a field."""
        batch = seen.batch
        first, last = self.act[0], self.act[2]
        assert isinstance(first, nn.Linear)
        weight, bias = first.weight, first.bias
        width = seen.elements.shape[1]
        shared = functional.linear(seen.summary, weight[:, width:])  # of cat[element, summary], once for each page
        hidden = functional.linear(seen.elements, weight[:, :width], bias)
        hidden = torch.relu(hidden + functional.embedding(batch.element_page, shared))
        logits = functional.embedding(batch.row, last(hidden))
        legal = torch.stack([batch.clickable, batch.typable], dim=2)
        out: Tensor = logits.masked_fill(~legal, MASKED_LOGIT).flatten(1).log_softmax(1)
        return out

    def starts(self, seen: Encoding, element: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the first word, given the field that takes it."""
        field = seen.element(element)
        query = self.start(torch.cat([field, seen.summary.unsqueeze(1).expand_as(field)], dim=2))
        return _point(query, seen.words, seen.token_mask.unsqueeze(1))

    def ends(self, seen: Encoding, element: Tensor, start: Tensor) -> Tensor:
        """[B, M, L] log-probabilities of the last word, which is not before the first."""
        query = self.end(torch.cat([seen.element(element), seen.token(start)], dim=2))
        after = torch.arange(seen.token_mask.shape[1], device=start.device) >= start.unsqueeze(2)
        return _point(query, seen.words, seen.token_mask.unsqueeze(1) & after)

    def sample(self, seen: Encoding, uniform: Tensor | None) -> tuple[ActionBatch, Tensor]:
        """M actions for each page and their log-probabilities [B, M], nats.

        `uniform` [B, M, 3] in [0, 1) drives the draws; None takes the one likeliest action.
        """
        draws = (None, None, None) if uniform is None else uniform.unbind(2)
        pairs = self.pairs(seen)
        pair = pairs.argmax(1, keepdim=True) if draws[0] is None else draw(pairs, draws[0])
        verb, element = pair % VERBS, pair // VERBS
        logp, typing = pairs.gather(1, pair), verb == Verb.TYPE
        start = end = torch.full_like(pair, NO_SPAN)
        pages = typing.any(1).nonzero().squeeze(1)
        if len(pages):
            some, element, typed = seen.take(pages), element[pages], typing[pages]
            starts = self.starts(some, element)
            first = starts.argmax(2) if draws[1] is None else draw(starts, draws[1][pages].unsqueeze(2)).squeeze(2)
            ends = self.ends(some, element, first)
            last = ends.argmax(2) if draws[2] is None else draw(ends, draws[2][pages].unsqueeze(2)).squeeze(2)
            logp = logp.index_add(0, pages, torch.where(typed, _at(starts, first) + _at(ends, last), 0.0))
            start = start.index_copy(0, pages, torch.where(typed, first, NO_SPAN))
            end = end.index_copy(0, pages, torch.where(typed, last, NO_SPAN))
        return ActionBatch(verb=verb, element=pair // VERBS, start=start, end=end), logp

    def evaluate(self, seen: Encoding, actions: ActionBatch) -> tuple[Tensor, Tensor]:
        """log pi(a | s, g) [B, M] and the entropy of pi(. | s, g) [B], nats.

        The entropy of the copied words is that at the field of the first action, if it types.
        """
        pairs = self.pairs(seen)
        logp, entropy = pairs.gather(1, actions.element * VERBS + actions.verb), _entropy(pairs)
        typing = actions.verb == Verb.TYPE
        pages = typing.any(1).nonzero().squeeze(1)
        if len(pages):
            some, element, typed = seen.take(pages), actions.element[pages], typing[pages]
            start, end = actions.start[pages].clamp(min=0), actions.end[pages].clamp(min=0)
            starts = self.starts(some, element)
            ends = self.ends(some, element, start)
            logp = logp.index_add(0, pages, torch.where(typed, _at(starts, start) + _at(ends, end), 0.0))
            copied = torch.where(typed[:, 0], _entropy(starts[:, 0]) + _entropy(ends[:, 0]), 0.0)
            entropy = entropy.index_add(0, pages, copied)
        return logp, entropy

    def state_value(self, seen: Encoding) -> Tensor:
        """V(s, g) [B]."""
        value: Tensor = self.value(seen.summary).squeeze(1)
        return value


class RewardNet(nn.Module):
    """The logit of D_phi(s, a | g): a page as its encoder reads it, with the action marked, ending in one number."""

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.encoder = Encoder(vectors, config)
        self.verb = nn.Embedding(VERBS, 16)
        self.absent = nn.Parameter(torch.zeros(2, width))  # nothing typed; typed words that the goal lacks
        self.head = nn.Sequential(nn.Linear(4 * width + 16, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """[B, M] logits, log D - log(1 - D), of M actions on each page."""
        out: Tensor = self.head(self.encode(self.encoder(batch), actions)).squeeze(2)
        return out

    def encode(self, seen: Encoding, actions: ActionBatch) -> Tensor:
        """[B, M, 4 * width + 16]: the action's element, the page and goal, the words copied, the verb."""
        copied = (actions.start >= 0).unsqueeze(2)
        absent = self.absent[(actions.verb == Verb.TYPE).long()]
        element = seen.element(actions.element)
        first, last = absent, absent
        if bool(copied.any()):
            first = torch.where(copied, seen.token(actions.start.clamp(min=0)), absent)
            last = torch.where(copied, seen.token(actions.end.clamp(min=0)), absent)
        return torch.cat(
            [element, seen.summary.unsqueeze(1).expand_as(element), first, last, self.verb(actions.verb)], dim=2
        )


def draw(logp: Tensor, uniform: Tensor) -> Tensor:
    """[..., M] the column of logp [..., C] where the cumulative probability passes `uniform` [..., M]."""
    passed = torch.searchsorted(logp.exp().cumsum(-1), uniform.contiguous(), right=True)
    legal = (logp > MASKED_LOGIT / 2).long()
    last = logp.shape[-1] - 1 - legal.flip(-1).argmax(-1, keepdim=True)  # rounding may leave the sum below 1
    return torch.minimum(passed, last)


def _at(logp: Tensor, index: Tensor) -> Tensor:
    """[B, M]: logp[b, m, index[b, m]]."""
    return logp.gather(2, index.unsqueeze(2)).squeeze(2)


def _point(query: Tensor, keys: Tensor, mask: Tensor) -> Tensor:
    """[B, M, L] log-probabilities of the keys [B, L, D] under the queries [B, M, D]."""
    scores = torch.bmm(query, keys.transpose(1, 2)) / query.shape[2] ** 0.5
    logp: Tensor = scores.masked_fill(~mask, MASKED_LOGIT).log_softmax(2)
    return logp


def _entropy(logp: Tensor) -> Tensor:
    """Over the last axis, nats."""
    entropy: Tensor = -(logp.exp() * logp).sum(1)
    return entropy
