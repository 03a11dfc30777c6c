"""Learning rates and the entropy weight fall over a run, and over a cloned start."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from giirl_core.config import CloningConfig, Config, DiscriminatorConfig, NetConfig, PolicyConfig
from giirl_core.metrics import Metrics
from learner.data import Example
from learner.learner import Learner
from tests.learner.samples import expert_episodes


def test_the_learning_rate_falls_while_the_policy_is_cloned_before_the_first_iteration() -> None:
    demonstrations = [episode.trajectory for episode in expert_episodes(1)]
    config = Config(
        net=NetConfig(width=16, vectors="hashed"),
        policy=PolicyConfig(bc_warmup_updates=4),
        cloning=CloningConfig(learning_rate=1e-3, final_lr_fraction=0.2, batch=1),
    )
    learner = Learner(config, demonstrations, Metrics())
    rates: list[float] = []
    update = learner.cloner.update

    def record(expert: Sequence[Example]) -> dict[str, float]:
        rates.append(learner.cloner.optimiser.param_groups[0]["lr"])
        return update(expert)

    learner.cloner.update = record  # type: ignore[method-assign]
    assert len([*learner.bc_warmup()]) == 4
    assert rates == pytest.approx([1e-3, 0.8e-3, 0.6e-3, 0.4e-3])


def test_the_accuracy_schedule_lowers_the_rate_from_accuracy_1_to_one_half() -> None:
    demonstrations = [episode.trajectory for episode in expert_episodes(1)]
    config = Config(
        net=NetConfig(width=16, vectors="hashed"),
        discriminator=DiscriminatorConfig(lr_schedule="accuracy", learning_rate=1.0, final_lr_fraction=0.1),
    )
    learner = Learner(config, demonstrations, Metrics())
    for accuracy, rate in ((1.0, 1.0), (0.75, 0.55), (0.5, 0.1), (0.0, 0.1)):
        learner.discriminator.accuracy = accuracy
        learner.anneal(config.iterations // 2)
        assert learner.discriminator.optimiser.param_groups[0]["lr"] == pytest.approx(rate)


def test_learning_rates_and_entropy_decay_linearly() -> None:
    demonstrations = [episode.trajectory for episode in expert_episodes(1)]
    config = Config(
        iterations=101,
        net=NetConfig(width=16, vectors="hashed"),
        policy=PolicyConfig(learning_rate=1.0, final_lr_fraction=0.2, entropy=0.5, final_entropy_fraction=0.4),
        cloning=CloningConfig(learning_rate=2.0, final_lr_fraction=0.2),
    )
    learner = Learner(config, demonstrations, Metrics())
    for step, rate, entropy in ((0, 1.0, 0.5), (50, 0.6, 0.35), (100, 0.2, 0.2)):
        learner.anneal(step)
        assert learner.policy.optimiser.param_groups[0]["lr"] == pytest.approx(rate)
        assert learner.cloner.optimiser.param_groups[0]["lr"] == pytest.approx(2 * rate)
        assert learner.policy.entropy == pytest.approx(entropy)
