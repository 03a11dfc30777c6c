"""The discriminator: which pairs it learns from, and whose rewards reach the policy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from prometheus_client import generate_latest

from giirl_core.config import Config, DiscriminatorConfig, StreamConfig
from giirl_core.config import NetConfig as Net
from giirl_core.metrics import Metrics
from giirl_core.types import UNSCORED, Trajectory
from learner.learner import Learner
from learner.protocols import ACCURACY, EXPERT
from tests.learner.samples import WIDTH, expert_episodes

SMALL = DiscriminatorConfig(batch=16, updates=1)


@pytest.fixture(scope="module")
def demonstrations() -> list[Trajectory]:
    return [episode.trajectory for episode in expert_episodes(4)]


def learner(shown: list[Trajectory], config: DiscriminatorConfig = SMALL, reward_lag: int = 1) -> Learner:
    net, stream = Net(width=WIDTH, vectors="hashed"), StreamConfig(reward_lag=reward_lag)
    return Learner(Config(net=net, discriminator=config, stream=stream), shown, Metrics())


def scored(shown: list[Trajectory], version: int) -> list[Trajectory]:
    """Rollouts that came with a reward of 9 from this version."""
    nine = [np.full(len(t), 9.0, dtype=np.float32) for t in shown]
    return [replace(t, rewards=r, reward_version=version, policy_version=0) for t, r in zip(shown, nine, strict=True)]


def sources(stats: dict[str, float]) -> set[str]:
    return {name.removeprefix(ACCURACY) for name in stats if name.startswith(ACCURACY)}


def test_the_plain_thesis_form_has_two_sources_and_the_default_six(demonstrations: list[Trajectory]) -> None:
    plain = replace(SMALL, replay=0.0, policy_on_expert_states=0.0, random_actions=0.0, wrong_goal=0.0)
    for config, wanted in (
        (plain, {EXPERT, "rollouts"}),
        (SMALL, {EXPERT, "rollouts", "replay", "policy_on_expert_states", "random_actions", "wrong_goal"}),
    ):
        mind = learner(demonstrations, config)
        rollouts = mind.featurise(scored(demonstrations, 0))
        mind.discriminator.update(mind.demos.sample(16), rollouts, mind.policy.net)
        stats = mind.discriminator.update(mind.demos.sample(16), rollouts, mind.policy.net)
        assert sources(stats) == wanted


def test_it_learns_to_tell_experts_from_what_it_is_shown_as_the_policys(demonstrations: list[Trajectory]) -> None:
    mind = learner(
        demonstrations,
        replace(
            SMALL, replay=0.0, policy_on_expert_states=0.0, random_actions=0.0, learning_rate=0.01, rename_prob=0.0
        ),
    )
    buttons = [t for t in demonstrations if t.task == "click-button"]
    others = [replace(t, actions=tuple(replace(a, element=(a.element + 1) % 6) for a in t.actions)) for t in buttons]
    rollouts = mind.featurise(scored(others, 0))
    for _ in range(80):
        stats = mind.discriminator.update(mind.featurise(buttons), rollouts, mind.policy.net)
    assert stats[ACCURACY + EXPERT] > 0.9
    assert stats[ACCURACY + "rollouts"] > 0.9
    right = mind.discriminator.rewards(mind.featurise(buttons), version=9)
    wrong = mind.discriminator.rewards(mind.featurise(others), version=9)
    assert torch.cat(right).mean() > torch.cat(wrong).mean() + 2


def test_rewards_too_old_are_computed_again_by_the_same_function(demonstrations: list[Trajectory]) -> None:
    metrics = Metrics()
    net = Net(width=WIDTH, vectors="hashed")
    mind = Learner(Config(net=net, discriminator=SMALL, stream=StreamConfig(reward_lag=1)), demonstrations, metrics)
    mixed = scored(demonstrations[:2], 4) + scored(demonstrations[2:5], 3)
    rewards = mind.discriminator.rewards(mind.featurise(mixed), version=5)
    fresh = mind.discriminator.model.score(mixed)
    assert [r.flatten().tolist() for r in rewards[:2]] == [[9.0] * len(t) for t in mixed[:2]]
    for got, wanted in zip(rewards[2:], fresh[2:], strict=True):
        np.testing.assert_allclose(got.flatten().numpy(), wanted, atol=1e-5)
    exposed = generate_latest(metrics.registry).decode()
    steps = [len(t) for t in mixed]
    assert f'giirl_rewards_used_total{{source="service"}} {float(sum(steps[:2]))}' in exposed
    assert f'giirl_rewards_used_total{{source="learner"}} {float(sum(steps[2:]))}' in exposed


@pytest.mark.parametrize("lag", [0, 1])
def test_an_unscored_rollout_is_scored_however_much_lag_is_allowed(lag: int, demonstrations: list[Trajectory]) -> None:
    mind = learner(demonstrations, reward_lag=lag)
    rewards = mind.discriminator.rewards(mind.featurise(scored(demonstrations, UNSCORED)), version=1)
    assert not any(9.0 in reward for reward in rewards)


def test_a_gradient_penalty_flattens_what_is_learned(demonstrations: list[Trajectory]) -> None:
    spread = []
    for weight in (0.0, 100.0):
        mind = learner(demonstrations, replace(SMALL, gradient_penalty=weight, learning_rate=0.01))
        rollouts = mind.featurise(scored(demonstrations, UNSCORED))
        for _ in range(15):
            stats = mind.discriminator.update(mind.demos.sample(16), rollouts, mind.policy.net)
        assert (stats["d_penalty"] > 0) == (weight > 0)
        spread.append(torch.cat(mind.discriminator.rewards(rollouts, version=99)).std().item())
    assert spread[1] < spread[0]
