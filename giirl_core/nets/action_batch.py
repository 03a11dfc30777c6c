"""Actions on many pages as tensors, and the uniformly random policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from giirl_core.choices import Choice, choice_of
from giirl_core.gestures import BASIC, Allowed, Gesture, Takes
from giirl_core.nets.batch import Batch
from giirl_core.types import NO_SPAN, Action, Page, Trajectory


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionBatch:
    """M actions on each of B pages, with the fields of `Choice`."""

    gesture: Tensor  # [B, M] int64
    element: Tensor  # [B, M] int64
    start: Tensor  # [B, M] int64
    end: Tensor  # [B, M] int64

    def columns(self, first: int, last: int) -> ActionBatch:
        """[B, last - first] the actions `first` to `last - 1` on each page."""
        return ActionBatch(**{f.name: getattr(self, f.name)[:, first:last] for f in fields(self)})

    def replace_first(self, actions: ActionBatch) -> ActionBatch:
        """[B, M] with the `actions` [b, M] on the first b pages, and the own ones on the others."""
        columns = {f.name: (getattr(actions, f.name), getattr(self, f.name)) for f in fields(self)}
        return ActionBatch(**{name: torch.cat([new, old[len(new) :]]) for name, (new, old) in columns.items()})

    def table(self) -> Tensor:
        """[B, M, 4] int64: gesture, element, start, end."""
        return torch.stack([self.gesture, self.element, self.start, self.end], dim=2)

    def first(self) -> list[Choice]:
        """[B] the first action on each page."""
        return [Choice(*row) for row in self.table()[:, 0].tolist()]

    def to(self, device: torch.device) -> ActionBatch:
        """The actions on another device."""
        return ActionBatch(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})


def join(*parts: ActionBatch) -> ActionBatch:
    """[B, sum of M] the actions of all parts, concatenated on each page."""
    return ActionBatch(
        **{f.name: torch.cat([getattr(part, f.name) for part in parts], dim=1) for f in fields(ActionBatch)}
    )


def collate_choices(choices: Sequence[Choice]) -> ActionBatch:
    """[B, 1] one action on each of B pages."""
    return ActionBatch(**{name: part.unsqueeze(1) for name, part in _columns(choices).items()})


def collate_candidates(choices: Sequence[Choice]) -> ActionBatch:
    """[1, M] M candidate actions on one page."""
    return ActionBatch(**{name: part.unsqueeze(0) for name, part in _columns(choices).items()})


def choose(action: Action, page: Page, gestures: Sequence[Gesture]) -> Choice:
    """An action on a page as a choice; ValueError if it is none of the gestures."""
    choice = choice_of(action, page, gestures)
    if choice is None:
        raise ValueError(f"{action} is none of the {len(gestures)} gestures of the nets: wanted one of them")
    return choice


def collate_sampled(trajectories: Sequence[Trajectory]) -> tuple[ActionBatch, Tensor]:
    """The sampled actions [sum T, M] of all trajectories, and their log-probabilities when they were sampled, nats.

    M is 0 if no trajectory has sampled actions. ValueError if the trajectories have different M.
    """
    sampled = [trajectory.sampled for trajectory in trajectories]
    counts = {part.logp.shape[1] if part is not None else 0 for part in sampled}
    if len(counts) != 1:
        raise ValueError(f"trajectories have {sorted(counts)} sampled actions a step, wanted the same number for all")
    steps = sum(map(len, trajectories))
    parts = [part for part in sampled if part is not None]
    table = np.concatenate([part.choices for part in parts]) if parts else np.zeros((steps, 0, 4), np.int16)
    logp = np.concatenate([part.logp for part in parts]) if parts else np.zeros((steps, 0), np.float32)
    gesture, element, start, end = torch.from_numpy(table.astype(np.int64)).unbind(2)
    return ActionBatch(gesture=gesture, element=element, start=start, end=end), torch.from_numpy(logp)


def _columns(choices: Sequence[Choice]) -> dict[str, Tensor]:
    """[B] each field of B choices."""
    table = torch.from_numpy(np.array(choices, dtype=np.int64).reshape(-1, 4))
    return dict(zip(Choice._fields, table.unbind(1), strict=True))


def legal_pairs(batch: Batch, gestures: Sequence[Gesture]) -> Tensor:
    """[B, E, G] bool: whether each gesture can be made on each element."""
    first = torch.zeros_like(batch.real)
    first[:, 0] = batch.real[:, 0]
    kinds = {Allowed.LEAVES: batch.clickable, Allowed.FIELDS: batch.typable, Allowed.ALL: batch.real}
    kinds[Allowed.FIRST] = first
    return torch.stack([kinds[gesture.allowed] for gesture in gestures], dim=2)


def random_actions(batch: Batch, uniform: Tensor, gestures: Sequence[Gesture]) -> ActionBatch:
    """[B, M] actions of the random policy, computed from the random numbers `uniform` [B, M, 3] in [0, 1).

    It is uniform over the legal pairs of an element and a basic gesture, click or type; with the same probability, if
    there are further gestures, over those of an element and a further one. It types a first word that is uniform over
    the goal, up to a last one that is uniform over the rest. A second element is uniform over the page.
    """
    legal = legal_pairs(batch, gestures)
    pair = _random_pair(legal, uniform[:, :, 0])
    gesture = pair % len(gestures)
    words, elements = batch.token_mask.sum(1, keepdim=True), batch.real.sum(1, keepdim=True)
    start = (uniform[:, :, 1] * words).long().clamp(max=words - 1)
    end = start + (uniform[:, :, 2] * (words - start)).long().clamp(max=words - start - 1)
    second = (uniform[:, :, 1] * elements).long().clamp(max=elements - 1)
    none = torch.full_like(start, NO_SPAN)
    typing, pairing = takes_words(gestures)[gesture], takes_second(gestures)[gesture]
    return ActionBatch(
        gesture=gesture,
        element=pair // len(gestures),
        start=torch.where(typing, start, torch.where(pairing, second, none)),
        end=torch.where(typing, end, none),
    )


def _random_pair(legal: Tensor, uniform: Tensor) -> Tensor:
    """[B, M] random pairs of element and gesture, as indices of the pairs that are `legal` [B, E, G]."""
    basic, further = _halves(legal)
    if further is None:
        return _nth(basic, uniform)
    none = ~further.any(1, keepdim=True)
    is_basic = (uniform < 0.5) | none
    within = torch.where(none, uniform, torch.where(is_basic, 2 * uniform, 2 * uniform - 1))
    return torch.where(is_basic, _nth(basic, within), _nth(further, within))


def _halves(legal: Tensor) -> tuple[Tensor, Tensor | None]:
    """The legal pairs [B, E * G] of basic gestures, and of further ones, None without any."""
    if legal.shape[2] == len(BASIC):
        return legal.flatten(1), None
    is_basic = torch.arange(legal.shape[2], device=legal.device) < len(BASIC)
    return (legal & is_basic).flatten(1), (legal & ~is_basic).flatten(1)


def _nth(legal: Tensor, uniform: Tensor) -> Tensor:
    """[B, M] the index of a pair that is uniform over the `legal` [B, E * G] ones."""
    count = legal.sum(1, keepdim=True)
    nth = (uniform * count).long().clamp(max=count - 1).contiguous()
    return torch.searchsorted(legal.long().cumsum(1), nth, right=True).clamp(max=legal.shape[1] - 1)


def random_logp(batch: Batch, actions: ActionBatch, gestures: Sequence[Gesture]) -> Tensor:
    """[B, M] log-probabilities of legal actions under `random_actions`, nats."""
    basic, further = _halves(legal_pairs(batch, gestures))
    pairs = basic.sum(1, keepdim=True).float()
    if further is not None:
        is_basic = actions.gesture < len(BASIC)
        others = further.sum(1, keepdim=True).float()
        pairs = torch.where(is_basic, pairs, others) * torch.where(others > 0, 2.0, 1.0)
    words = batch.token_mask.sum(1, keepdim=True).float()
    spans = words.log() + (words - actions.start.clamp(min=0)).log()
    logp = -pairs.log() - torch.where(takes_words(gestures)[actions.gesture], spans, 0.0)
    seconds = batch.real.sum(1, keepdim=True).float().log()
    return logp - torch.where(takes_second(gestures)[actions.gesture], seconds, 0.0)


def takes_words(gestures: Sequence[Gesture]) -> Tensor:
    """[G] bool: the gestures that type words of the goal."""
    return torch.tensor([gesture.takes is Takes.WORDS for gesture in gestures])


def takes_second(gestures: Sequence[Gesture]) -> Tensor:
    """[G] bool: the gestures that take a second element."""
    return torch.tensor([gesture.has_second for gesture in gestures])
