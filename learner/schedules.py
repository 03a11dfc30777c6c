"""Schedules of learning rates and the entropy weight: linear over the run, or by the discriminator's accuracy."""

from __future__ import annotations

from typing import Protocol

import torch

from giirl_core.config import DiscriminatorConfig


class LearningRates(Protocol):
    """The settings of a learning rate: the first one, and the last one as a fraction of it."""

    @property
    def learning_rate(self) -> float: ...

    @property
    def final_lr_fraction(self) -> float: ...


class Annealed(Protocol):
    """A part of the learner that has its own optimiser."""

    @property
    def config(self) -> LearningRates: ...

    @property
    def optimiser(self) -> torch.optim.Optimizer: ...


class AnnealedDiscriminator(Protocol):
    """A discriminator with its own optimiser."""

    @property
    def config(self) -> DiscriminatorConfig: ...

    @property
    def optimiser(self) -> torch.optim.Optimizer: ...

    @property
    def accuracy(self) -> float: ...  # 1/2 when it can no longer tell the expert from the newest rollouts


def anneal(part: Annealed, progress: float) -> None:
    """Set the learning rate of `part` for `progress` in [0, 1] of the run, on a line from its first to its last one."""
    for group in part.optimiser.param_groups:
        group["lr"] = linear_decay(part.config.learning_rate, part.config.final_lr_fraction, progress)


def linear_decay(initial: float, final_fraction: float, progress: float) -> float:
    """The value at `progress` in [0, 1] on the line from `initial` to `final_fraction * initial`."""
    return initial * (1 - progress * (1 - final_fraction))


def anneal_discriminator(discriminator: AnnealedDiscriminator, progress: float) -> None:
    """Set the learning rate of the discriminator by its `lr_schedule`: "linear" as `anneal`, or "accuracy".

    "accuracy" lowers the rate as the policy improves (Luo 2019, section 5.1): from the first rate at accuracy 1 to the
    last one at accuracy 1/2, where the newest rollouts look like the expert.
    """
    confusion = min(max(2.0 - 2.0 * discriminator.accuracy, 0.0), 1.0)
    anneal(discriminator, confusion if discriminator.config.lr_schedule == "accuracy" else progress)
