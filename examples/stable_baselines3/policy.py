"""A policy of Stable-Baselines3 that scores each slot with the same small net, and never chooses an empty one."""

from __future__ import annotations

from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor, nn

from examples.stable_baselines3.slots import FEATURES, SLOTS

WIDTH = 32
EMPTY_LOGIT = -1e9  # an empty slot is never chosen


class SlotNet(nn.Module):
    """From flat observations [B, SLOTS * F] to logits [B, SLOTS] and to what the value is read from, [B, 2 * WIDTH]."""

    latent_dim_pi, latent_dim_vf = SLOTS, 2 * WIDTH

    def __init__(self) -> None:
        super().__init__()
        self.score = nn.Sequential(nn.Linear(len(FEATURES), WIDTH), nn.Tanh(), nn.Linear(WIDTH, 1))
        self.read = nn.Sequential(nn.Linear(len(FEATURES), WIDTH), nn.Tanh())

    def forward(self, flat: Tensor) -> tuple[Tensor, Tensor]:
        return self.forward_actor(flat), self.forward_critic(flat)

    def forward_actor(self, flat: Tensor) -> Tensor:
        slots = flat.reshape(-1, SLOTS, len(FEATURES))
        scores: Tensor = self.score(slots).squeeze(-1)
        return scores.masked_fill(slots[..., 0] == 0, EMPTY_LOGIT)

    def forward_critic(self, flat: Tensor) -> Tensor:
        read = self.read(flat.reshape(-1, SLOTS, len(FEATURES)))
        return torch.cat((read.mean(dim=1), read.amax(dim=1)), dim=1)


class SlotPolicy(ActorCriticPolicy):
    """The scores of the slots are the logits of the actions."""

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = SlotNet()  # type: ignore[assignment] # of the same form

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        self.action_net = nn.Identity()
