"""What falls while a run goes on: with time, or as the policy comes to do what the expert does."""

from __future__ import annotations

from typing import Protocol

import torch

from giirl_core.config import DiscriminatorConfig


class Rates(Protocol):
    """The settings that say how."""

    @property
    def learning_rate(self) -> float: ...

    @property
    def final_lr_fraction(self) -> float: ...


class Annealed(Protocol):
    """Whatever learns at a rate of its own."""

    @property
    def config(self) -> Rates: ...

    @property
    def optimiser(self) -> torch.optim.Optimizer: ...


class AnnealedReward(Protocol):
    """A discriminator."""

    @property
    def config(self) -> DiscriminatorConfig: ...

    @property
    def optimiser(self) -> torch.optim.Optimizer: ...

    @property
    def accuracy(self) -> float: ...  # 1/2 where it cannot tell expert and newest rollouts apart any more


def anneal(part: Annealed, done: float) -> None:
    """Set the rate for when `done` in [0, 1] is over: a straight line from the first rate to the final one."""
    for group in part.optimiser.param_groups:
        group["lr"] = linear_decay(part.config.learning_rate, part.config.final_lr_fraction, done)


def linear_decay(first: float, share: float, done: float) -> float:
    """On a straight line from `first` to that share of it, when `done` in [0, 1] is over."""
    return first * (1 - done * (1 - share))


def anneal_reward(discriminator: AnnealedReward, done: float) -> None:
    """The same for a discriminator. `lr_schedule="accuracy"` lowers it as the policy improves (thesis, section 5.1).

    Then its rate is the final one where it cannot tell the newest rollouts from the expert any more.
    """
    caught_up = min(max(2.0 - 2.0 * discriminator.accuracy, 0.0), 1.0)
    anneal(discriminator, caught_up if discriminator.config.lr_schedule == "accuracy" else done)
