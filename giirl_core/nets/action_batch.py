"""Actions on many pages as tensors, and the uniformly random policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from giirl_core.nets.batch import Batch
from giirl_core.types import NO_SPAN, Action, Trajectory, Verb


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionBatch:
    """M actions on each of B pages. `start` and `end` are the first and last goal token to type, -1 for none."""

    verb: Tensor  # [B, M] int64
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
        """[B, M, 4] int64: verb, element, start, end."""
        return torch.stack([self.verb, self.element, self.start, self.end], dim=2)

    def first(self) -> list[Action]:
        """[B] the first action on each page."""
        columns = (part[:, 0].tolist() for part in (self.verb, self.element, self.start, self.end))
        return [
            Action(verb=Verb(verb), element=element, start=start, end=end)
            for verb, element, start, end in zip(*columns, strict=True)
        ]

    def to(self, device: torch.device) -> ActionBatch:
        """The actions on another device."""
        return ActionBatch(**{f.name: getattr(self, f.name).to(device) for f in fields(self)})


def join(*parts: ActionBatch) -> ActionBatch:
    """[B, sum of M] the actions of all parts, concatenated on each page."""
    return ActionBatch(
        **{f.name: torch.cat([getattr(part, f.name) for part in parts], dim=1) for f in fields(ActionBatch)}
    )


def collate_actions(actions: Sequence[Action]) -> ActionBatch:
    """[B, 1] one action on each of B pages."""
    verb, element, start, end = _table(actions).unsqueeze(2)
    return ActionBatch(verb=verb, element=element, start=start, end=end)


def collate_candidates(actions: Sequence[Action]) -> ActionBatch:
    """[1, M] M candidate actions on one page."""
    verb, element, start, end = _table(actions).unsqueeze(1)
    return ActionBatch(verb=verb, element=element, start=start, end=end)


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
    verb, element, start, end = torch.from_numpy(table.astype(np.int64)).unbind(2)
    return ActionBatch(verb=verb, element=element, start=start, end=end), torch.from_numpy(logp)


def _table(actions: Sequence[Action]) -> Tensor:
    """[4, B]: verb, element, start, end."""
    table = np.array([(a.verb, a.element, a.start, a.end) for a in actions], dtype=np.int64).reshape(-1, 4)
    return torch.from_numpy(table).T.contiguous()


def random_actions(batch: Batch, uniform: Tensor) -> ActionBatch:
    """[B, M] actions of the random policy, computed from the random numbers `uniform` [B, M, 3] in [0, 1).

    It is uniform over the legal (element, verb) pairs, then over the first word to type, then over the last one.
    """
    legal = torch.stack([batch.clickable, batch.typable], dim=2).flatten(1)  # [B, E * verbs], verbs CLICK and TYPE
    count = legal.sum(1, keepdim=True)
    nth = (uniform[:, :, 0] * count).long().clamp(max=count - 1).contiguous()
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
    """[B, M] log-probabilities of legal actions under `random_actions`, nats."""
    pairs = (batch.clickable.sum(1) + batch.typable.sum(1)).unsqueeze(1).float()
    words = batch.token_mask.sum(1, keepdim=True).float()
    spans = words.log() + (words - actions.start.clamp(min=0)).log()
    return -pairs.log() - torch.where(actions.verb == Verb.TYPE, spans, 0.0)
