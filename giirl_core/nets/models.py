"""The policy net and the reward net. Each has its own encoder."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import NetConfig
from giirl_core.gestures import read_gestures
from giirl_core.nets.action_batch import ActionBatch, legal_pairs, takes_second, takes_words
from giirl_core.nets.batch import MASKED_LOGIT, Batch
from giirl_core.nets.encoder import Encoder, Encoding
from giirl_core.nets.language import Vectors
from giirl_core.types import NO_SPAN


class PolicyNet(nn.Module):
    """pi_theta(a | s, g) and V(s, g), as a pointer network over the elements of a page and the tokens of a goal.

    An action is sampled in parts: the pair (element, gesture), then what the gesture takes: the first and the last goal
    token to type, or a second element. A page is encoded once, `encoding = net.encoder(batch)`. Any number of actions
    on it can then be sampled and evaluated.
    """

    takes_words: Tensor  # [G] bool
    takes_second: Tensor  # [G] bool

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.gestures = read_gestures(config.gestures)
        count = len(self.gestures)
        self.encoder = Encoder(vectors, config)
        self.pair_head = nn.Sequential(nn.Linear(2 * width, width), nn.ReLU(), nn.Linear(width, count))
        self.start_query = nn.Linear(2 * width, width)
        self.end_query = nn.Linear(2 * width, width)
        self.value_head = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
        has_second = any(gesture.has_second for gesture in self.gestures)
        self.second_query = nn.Linear(2 * width, width) if has_second else None
        self.gesture = nn.Embedding(count, width) if has_second else None  # for the second element
        self.register_buffer("takes_words", takes_words(self.gestures), persistent=False)
        self.register_buffer("takes_second", takes_second(self.gestures), persistent=False)

    @property
    def device(self) -> torch.device:
        """The device of the parameters."""
        return self.encoder.table.device

    def pair_logp(self, encoding: Encoding) -> Tensor:
        """[B, E * G] log-probabilities of pairs of an element and a gesture."""
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
        out: Tensor = logits.masked_fill(~legal_pairs(batch, self.gestures), MASKED_LOGIT).flatten(1).log_softmax(1)
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

    def second_logp(self, encoding: Encoding, element: Tensor, gesture: Tensor) -> Tensor:
        """[B, M, E] log-probabilities of the second element of gestures [B, M] on elements [B, M]."""
        assert self.second_query is not None
        assert self.gesture is not None
        first = encoding.element(element)
        summary = encoding.summary.unsqueeze(1).expand_as(first)
        query = self.second_query(torch.cat([first + self.gesture(gesture), summary], dim=2))
        return _pointer_logp(query, encoding.page_elements, encoding.element_mask.unsqueeze(1))

    def sample(self, encoding: Encoding, uniform: Tensor | None) -> tuple[ActionBatch, Tensor]:
        """M actions for each page, and their log-probabilities [B, M], nats.

        `uniform` [B, M, 3] in [0, 1) holds the random numbers. With None, the result is the greedy action (M = 1): the
        most probable pair, then the most probable first token, then the most probable last token, or second element.
        """
        u_pair, u_start, u_end = (None, None, None) if uniform is None else uniform.unbind(2)
        pairs = self.pair_logp(encoding)
        pair = pairs.argmax(1, keepdim=True) if u_pair is None else sample_categorical(pairs, u_pair)
        gesture, element = pair % len(self.gestures), pair // len(self.gestures)
        logp = pairs.gather(1, pair)
        start = end = torch.full_like(pair, NO_SPAN)
        typing, pages = _where(self.takes_words[gesture])
        if len(pages):
            subset = encoding.select(pages)
            starts = self.start_logp(subset, element[pages])
            first = _pick(starts, u_start, pages)
            ends = self.end_logp(subset, element[pages], first)
            last = _pick(ends, u_end, pages)
            logp = logp.index_add(0, pages, torch.where(typing, _at(starts, first) + _at(ends, last), 0.0))
            start = start.index_copy(0, pages, torch.where(typing, first, NO_SPAN))
            end = end.index_copy(0, pages, torch.where(typing, last, NO_SPAN))
        pairing, pages = _where(self.takes_second[gesture])
        if len(pages):
            seconds = self.second_logp(encoding.select(pages), element[pages], gesture[pages])
            second = _pick(seconds, u_start, pages)
            logp = logp.index_add(0, pages, torch.where(pairing, _at(seconds, second), 0.0))
            start = start.index_copy(0, pages, torch.where(pairing, second, start[pages]))
        return ActionBatch(gesture=gesture, element=element, start=start, end=end), logp

    def highest_logp(self, encoding: Encoding) -> Tensor:
        """[B] the log-probability of the most probable action, nats. The greedy action may be a less probable one."""
        logp = self.pair_logp(encoding).unflatten(1, (-1, len(self.gestures)))  # [B, E, G]
        size, count, length = len(logp), logp.shape[1], encoding.token_mask.shape[1]
        element = torch.arange(count, device=logp.device).expand(size, count)
        spans = torch.arange(count * length, device=logp.device).expand(size, count * length)
        ends = self.end_logp(encoding, spans // length, spans % length).amax(2).unflatten(1, (count, length))
        words = (self.start_logp(encoding, element) + ends).amax(2, keepdim=True)
        logp = logp + torch.where(self.takes_words, words, 0.0)
        for gesture in self.takes_second.nonzero().flatten().tolist():
            seconds = self.second_logp(encoding, element, torch.full_like(element, gesture))
            logp[:, :, gesture] += seconds.amax(2)
        highest: Tensor = logp.flatten(1).amax(1)
        return highest

    def evaluate(self, encoding: Encoding, actions: ActionBatch) -> tuple[Tensor, Tensor]:
        """log pi(a | s, g) [B, M] and the entropy of pi(. | s, g) [B], nats.

        The entropy is that of the (element, gesture) pair. If the first action types words, the entropies of its first
        and last token are added, given the element (and the first token) of that action; if it takes a second element,
        the entropy of that.
        """
        pairs = self.pair_logp(encoding)
        logp = pairs.gather(1, actions.element * len(self.gestures) + actions.gesture)
        entropy = _entropy(pairs)
        typing, pages = _where(self.takes_words[actions.gesture])
        if len(pages):
            subset, element = encoding.select(pages), actions.element[pages]
            start = torch.where(typing, actions.start[pages].clamp(min=0), 0)
            end = actions.end[pages].clamp(min=0)
            starts = self.start_logp(subset, element)
            ends = self.end_logp(subset, element, start)
            logp = logp.index_add(0, pages, torch.where(typing, _at(starts, start) + _at(ends, end), 0.0))
            span_entropy = torch.where(typing[:, 0], _entropy(starts[:, 0]) + _entropy(ends[:, 0]), 0.0)
            entropy = entropy.index_add(0, pages, span_entropy)
        pairing, pages = _where(self.takes_second[actions.gesture])
        if len(pages):
            seconds = self.second_logp(encoding.select(pages), actions.element[pages], actions.gesture[pages])
            second = torch.where(pairing, actions.start[pages], 0)
            logp = logp.index_add(0, pages, torch.where(pairing, _at(seconds, second), 0.0))
            entropy = entropy.index_add(0, pages, torch.where(pairing[:, 0], _entropy(seconds[:, 0]), 0.0))
        return logp, entropy

    def state_value(self, encoding: Encoding) -> Tensor:
        """V(s, g) [B]."""
        value: Tensor = self.value_head(encoding.summary).squeeze(1)
        return value


class RewardNet(nn.Module):
    """The logit of D_phi(s, a | g), log D - log(1 - D)."""

    takes_words: Tensor  # [G] bool
    takes_second: Tensor  # [G] bool

    def __init__(self, vectors: Vectors, config: NetConfig) -> None:
        super().__init__()
        width = config.width
        self.gestures = read_gestures(config.gestures)
        self.encoder = Encoder(vectors, config)
        self.gesture = nn.Embedding(len(self.gestures), 16)
        # In place of the first and last token: row 0 if no words are typed, row 1 if the goal lacks the typed text.
        self.absent = nn.Parameter(torch.zeros(2, width))
        self.head = nn.Sequential(nn.Linear(4 * width + 16, width), nn.ReLU(), nn.Linear(width, 1))
        self.register_buffer("takes_words", takes_words(self.gestures), persistent=False)
        self.register_buffer("takes_second", takes_second(self.gestures), persistent=False)

    def forward(self, batch: Batch, actions: ActionBatch) -> Tensor:
        """[B, M] logits of M actions on each page."""
        out: Tensor = self.head(self.encode(self.encoder(batch), actions)).squeeze(2)
        return out

    def encode(self, encoding: Encoding, actions: ActionBatch) -> Tensor:
        """[B, M, 4 * D + 16] the inputs of `head`: element, summary, first and last token, and gesture of each action.

        A second element stands in the place of the first token.
        """
        typing = self.takes_words[actions.gesture]
        absent = functional.embedding(typing.long(), self.absent)
        element = encoding.element(actions.element)
        first, last = absent, absent
        in_goal = (typing & (actions.start >= 0)).unsqueeze(2)
        if bool(in_goal.any()):
            start = torch.where(typing, actions.start.clamp(min=0), 0)
            first = torch.where(in_goal, encoding.token(start), absent)
            last = torch.where(in_goal, encoding.token(actions.end.clamp(min=0)), absent)
        pairing = self.takes_second[actions.gesture]
        if bool(pairing.any()):
            second = encoding.element(torch.where(pairing, actions.start, 0))
            first = torch.where(pairing.unsqueeze(2), second, first)
        summary = encoding.summary.unsqueeze(1).expand_as(element)
        return torch.cat([element, summary, first, last, self.gesture(actions.gesture)], dim=2)


def sample_categorical(logp: Tensor, uniform: Tensor) -> Tensor:
    """[..., M] column indices sampled from log-probabilities [..., C], by inverting the cumulative distribution.

    `uniform` [..., M] in [0, 1) holds the random numbers.
    """
    index = torch.searchsorted(logp.exp().cumsum(-1), uniform.contiguous(), right=True)
    legal = (logp > MASKED_LOGIT / 2).long()
    last_legal = logp.shape[-1] - 1 - legal.flip(-1).argmax(-1, keepdim=True)
    return torch.minimum(index, last_legal)  # through rounding, the sum of all probabilities may stay below `uniform`


def _where(takes: Tensor) -> tuple[Tensor, Tensor]:
    """The rows of `takes` [B, M] with any True, and their indices."""
    pages = takes.any(1).nonzero().squeeze(1)
    return takes[pages], pages


def _pick(logp: Tensor, uniform: Tensor | None, pages: Tensor) -> Tensor:
    """[b, M] one index for each of b x M distributions [b, M, C], by the random numbers of their pages, or the best."""
    if uniform is None:
        return logp.argmax(2)
    return sample_categorical(logp, uniform[pages].unsqueeze(2)).squeeze(2)


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
