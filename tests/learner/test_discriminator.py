"""The discriminator: the sources that it learns from, and the rewards that the policy is trained on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from prometheus_client import generate_latest

from giirl_core.config import Config, DiscriminatorConfig, StreamConfig
from giirl_core.config import NetConfig as Net
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import hash_nets
from giirl_core.types import UNSCORED, Trajectory
from learner.learner import Learner
from learner.protocols import ACCURACY, EXPERT
from tests.learner.samples import WIDTH, expert_episodes

SMALL = DiscriminatorConfig(batch=16, updates=1)


@pytest.fixture(scope="module")
def demonstrations() -> list[Trajectory]:
    return [episode.trajectory for episode in expert_episodes(4)]


def make_learner(demonstrations: list[Trajectory], config: DiscriminatorConfig = SMALL, reward_lag: int = 1) -> Learner:
    net, stream = Net(width=WIDTH, vectors="hashed"), StreamConfig(reward_lag=reward_lag)
    return Learner(Config(net=net, discriminator=config, stream=stream), demonstrations, Metrics())


def scored(episodes: list[Trajectory], version: int) -> list[Trajectory]:
    """Rollouts that carry the reward 9 for every step, from this version of the reward."""
    nine = [np.full(len(t), 9.0, dtype=np.float32) for t in episodes]
    return [
        replace(t, rewards=r, reward_version=version, policy_version=0) for t, r in zip(episodes, nine, strict=True)
    ]


def sources(stats: dict[str, float]) -> set[str]:
    return {name.removeprefix(ACCURACY) for name in stats if name.startswith(ACCURACY)}


def test_the_plain_thesis_form_has_two_sources_and_the_default_six(demonstrations: list[Trajectory]) -> None:
    plain = replace(SMALL, replay=0.0, policy_on_expert_states=0.0, random_actions=0.0, wrong_goal=0.0)
    for config, wanted in (
        (plain, {EXPERT, "rollouts"}),
        (replace(plain, wrong_step=1.0), {EXPERT, "rollouts", "wrong_step"}),
        (SMALL, {EXPERT, "rollouts", "replay", "policy_on_expert_states", "random_actions", "wrong_goal"}),
    ):
        learner = make_learner(demonstrations, config)
        rollouts = learner.featurise(scored(demonstrations, 0))
        learner.discriminator.update(learner.demos.sample(16), rollouts, learner.policy.net)
        stats = learner.discriminator.update(learner.demos.sample(16), rollouts, learner.policy.net)
        assert sources(stats) == wanted


@pytest.mark.parametrize(("weight", "kept"), [(0.0, 0), (0.1, 4)])
def test_rollouts_are_kept_for_replay_only_if_they_are_replayed(
    demonstrations: list[Trajectory], weight: float, kept: int
) -> None:
    learner = make_learner(demonstrations, replace(SMALL, replay=weight))
    rollouts = learner.featurise(scored(demonstrations[:4], 0))
    learner.discriminator.update(learner.demos.sample(16), rollouts, learner.policy.net)
    assert len(learner.replay.examples) == kept


@pytest.mark.parametrize("weight", [0.0, 0.1])
def test_without_rollouts_among_its_sources_it_never_sees_the_pages_of_the_policy(
    weight: float, demonstrations: list[Trajectory]
) -> None:
    learned = []
    for played in (demonstrations[:2], demonstrations[2:]):
        learner = make_learner(demonstrations, replace(SMALL, rollouts=weight, replay=weight))
        for _ in range(2):
            rollouts = learner.featurise(scored(played, 0))
            stats = learner.discriminator.update(learner.demos.sample(16), rollouts, learner.policy.net)
        learned.append(hash_nets(learner.discriminator.model.net))
    assert "random_actions" in sources(stats)
    assert (learned[0] == learned[1]) is (weight == 0.0)


def test_it_learns_to_tell_the_expert_from_the_policy(demonstrations: list[Trajectory]) -> None:
    learner = make_learner(
        demonstrations,
        replace(
            SMALL, replay=0.0, policy_on_expert_states=0.0, random_actions=0.0, learning_rate=0.01, rename_prob=0.0
        ),
    )
    buttons = [t for t in demonstrations if t.task == "click-button"]
    others = [replace(t, actions=tuple(replace(a, element=(a.element + 1) % 6) for a in t.actions)) for t in buttons]
    rollouts = learner.featurise(scored(others, 0))
    for _ in range(80):
        stats = learner.discriminator.update(learner.featurise(buttons), rollouts, learner.policy.net)
    assert stats[ACCURACY + EXPERT] > 0.9
    assert stats[ACCURACY + "rollouts"] > 0.9
    right = learner.discriminator.rewards(learner.featurise(buttons), version=9)
    wrong = learner.discriminator.rewards(learner.featurise(others), version=9)
    assert torch.cat(right).mean() > torch.cat(wrong).mean() + 2


def test_rewards_that_are_too_old_are_recomputed_with_the_same_function(demonstrations: list[Trajectory]) -> None:
    metrics = Metrics()
    net = Net(width=WIDTH, vectors="hashed")
    learner = Learner(Config(net=net, discriminator=SMALL, stream=StreamConfig(reward_lag=1)), demonstrations, metrics)
    mixed = scored(demonstrations[:2], 4) + scored(demonstrations[2:5], 3)
    rewards = learner.discriminator.rewards(learner.featurise(mixed), version=5)
    fresh = learner.discriminator.model.score(mixed)
    assert [r.flatten().tolist() for r in rewards[:2]] == [[9.0] * len(t) for t in mixed[:2]]
    for got, wanted in zip(rewards[2:], fresh[2:], strict=True):
        np.testing.assert_allclose(got.flatten().numpy(), wanted, atol=1e-5)
    exposed = generate_latest(metrics.registry).decode()
    steps = [len(t) for t in mixed]
    assert f'giirl_rewards_used_total{{source="service"}} {float(sum(steps[:2]))}' in exposed
    assert f'giirl_rewards_used_total{{source="learner"}} {float(sum(steps[2:]))}' in exposed


@pytest.mark.parametrize("lag", [0, 1])
def test_unscored_rollouts_are_scored_whatever_the_allowed_lag(lag: int, demonstrations: list[Trajectory]) -> None:
    learner = make_learner(demonstrations, reward_lag=lag)
    rewards = learner.discriminator.rewards(learner.featurise(scored(demonstrations, UNSCORED)), version=1)
    assert not any(9.0 in reward for reward in rewards)


def test_a_gradient_penalty_reduces_the_spread_of_the_rewards(demonstrations: list[Trajectory]) -> None:
    spread = []
    for weight in (0.0, 100.0):
        learner = make_learner(demonstrations, replace(SMALL, gradient_penalty=weight, learning_rate=0.01))
        rollouts = learner.featurise(scored(demonstrations, UNSCORED))
        for _ in range(15):
            stats = learner.discriminator.update(learner.demos.sample(16), rollouts, learner.policy.net)
        assert (stats["d_penalty"] > 0) == (weight > 0)
        spread.append(torch.cat(learner.discriminator.rewards(rollouts, version=99)).std().item())
    assert spread[1] < spread[0]
