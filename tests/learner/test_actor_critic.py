"""The policy update: policy gradients on the actions taken, and the soft-optimal choice among sampled actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from actors.agents import PolicyAgent
from giirl_core.choices import SampledActions
from giirl_core.config import PolicyConfig
from giirl_core.gestures import BASIC
from giirl_core.metrics import Metrics
from giirl_core.nets.action_batch import random_logp
from giirl_core.types import Action, EpisodeSpec, Goal, Observation, Verb
from learner.actor_critic import ActorCritic, soft_optimal
from learner.data import Example, collate_steps, featurise_trajectory, pad_rows, steps_of
from tests.learner.samples import (
    FLAT,
    SHORT,
    batch_of,
    legal_actions,
    on_one_page,
    policy,
    trajectory,
    vectors,
)

GOAL = "Type ok."
ALPHA = 0.5


def critic(**settings: float | str) -> ActorCritic:
    """An actor-critic with a small net."""
    config = replace(PolicyConfig(), **settings)  # type: ignore[arg-type]
    return ActorCritic(config, policy(), metrics=Metrics())


def rewards_of(actions: Sequence[Action]) -> Tensor:
    """[M] an arbitrary reward of each action, in [-1, 1]."""
    return torch.tensor([np.sin(2 * a.verb + 3 * a.element + 5 * a.start + 7 * a.end) for a in actions]).float()


def one_step(action: Action, logp: float = 0.0, sampled: SampledActions | None = None) -> Example:
    """A rollout of one action on the short page; `logp` is its behaviour log-probability."""
    rollout = trajectory(GOAL, [SHORT], [action])
    rollout = replace(rollout, behaviour_logp=np.array([logp], dtype=np.float32), sampled=sampled)
    return featurise_trajectory(rollout, vectors())


def sample(learner: ActorCritic, count: int, seed: int = 0) -> tuple[SampledActions, list[Action]]:
    """`count` actions that an actor with the current policy samples on the short page, in both forms."""
    agent = PolicyAgent(learner.net, vectors(), sampled_actions=count)
    observation = Observation(episode=EpisodeSpec(task="t", seed=0), page=SHORT, goal=Goal(GOAL))
    uniform = np.random.default_rng(seed).random((1, agent.draws, 3), dtype=np.float32)
    (decision,) = agent.select_actions([observation], uniform)
    assert decision.sampled is not None
    assert decision.sampled_logp is not None
    logp = decision.sampled_logp[None]
    rows = decision.sampled.tolist()
    actions = [Action(verb=Verb(verb), element=e, start=start, end=end) for verb, e, start, end in rows]
    return SampledActions(choices=decision.sampled[None], logp=logp, rewards=np.zeros_like(logp)), actions


def probabilities(learner: ActorCritic, actions: list[Action]) -> list[float]:
    """The probabilities of actions on the short page under the current policy."""
    with torch.no_grad():
        logp, _ = learner.net.evaluate(learner.net.encoder(batch_of((SHORT, Goal(GOAL)))), on_one_page(actions))
    return [float(p) for p in logp[0].exp()]


def test_the_policy_approaches_the_soft_optimal_distribution() -> None:
    learner = critic(vtrace_weight=0.0, entropy=ALPHA, learning_rate=0.01, updates=1)
    actions = legal_actions(SHORT, Goal(GOAL))
    optimal = (rewards_of(actions) / ALPHA).softmax(0).tolist()
    gap = np.abs(np.array(probabilities(learner, actions)) - optimal).sum()
    for seed in range(150):
        sampled, candidates = sample(learner, 64, seed)
        rollout = one_step(actions[0], sampled=sampled)
        learner.update([rollout], [torch.cat([torch.zeros(1), rewards_of(candidates)]).unsqueeze(0)])
    assert np.abs(np.array(probabilities(learner, actions)) - optimal).sum() < 0.5 * gap


def test_with_many_sampled_actions_the_target_equals_the_soft_optimal_distribution() -> None:
    learner = critic(entropy=ALPHA)
    sampled, candidates = sample(learner, 4_000)
    batch = batch_of((SHORT, Goal(GOAL)))
    proposal = torch.logaddexp(torch.from_numpy(sampled.logp), random_logp(batch, on_one_page(candidates), BASIC))
    target = soft_optimal(rewards_of(candidates).unsqueeze(0), proposal, ALPHA)[0]
    actions = legal_actions(SHORT, Goal(GOAL))
    for action, p in zip(actions, (rewards_of(actions) / ALPHA).softmax(0).tolist(), strict=True):
        same = torch.tensor([other == action for other in candidates])
        assert target[same].sum().item() == pytest.approx(p, abs=0.04)


def test_half_of_the_sampled_actions_are_uniformly_random() -> None:
    learner = critic()
    with torch.no_grad():  # a policy that always clicks
        learner.net.pair_head[2].bias.copy_(torch.tensor([20.0, -20.0]))  # type: ignore[operator]
    _, candidates = sample(learner, 400)
    verbs = np.array([action.verb for action in candidates])
    assert not verbs[:200].any()
    assert 0.2 < verbs[200:].mean() < 0.5  # one of three (element, verb) pairs types


def test_a_good_action_that_was_never_taken_is_learned_from_sampled_actions() -> None:
    learner = critic(vtrace_weight=0.0, learning_rate=0.01)
    bad, good = Action(verb=Verb.CLICK, element=1), Action(verb=Verb.TYPE, element=1, start=1, end=1)
    for seed in range(40):
        sampled, candidates = sample(learner, 32, seed)
        rewards = [0.0, *(2.0 if action == good else -2.0 for action in candidates)]
        learner.update([one_step(bad, sampled=sampled)], [torch.tensor([rewards])])
    assert probabilities(learner, [good])[0] > 0.8


def test_a_policy_with_a_cloned_prior_approaches_the_prior_weighted_by_the_reward() -> None:
    learner = critic(
        vtrace_weight=0.0, entropy=ALPHA, learning_rate=0.01, updates=1, prior="clone", bc_warmup_updates=1
    )
    actions = legal_actions(SHORT, Goal(GOAL))
    assert learner.prior is not None
    with torch.no_grad():
        learner.prior.pair_head[2].bias.copy_(torch.tensor([1.0, -1.0]))  # type: ignore[operator]
        logp, _ = learner.prior.evaluate(learner.prior.encoder(batch_of((SHORT, Goal(GOAL)))), on_one_page(actions))
    optimal = (rewards_of(actions) / ALPHA + logp[0]).softmax(0).tolist()
    gap = np.abs(np.array(probabilities(learner, actions)) - optimal).sum()
    for seed in range(150):
        sampled, candidates = sample(learner, 64, seed)
        rewards = torch.cat([torch.zeros(1), rewards_of(candidates)]).unsqueeze(0)
        stats = learner.update([one_step(actions[0], sampled=sampled)], [rewards])
    assert np.abs(np.array(probabilities(learner, actions)) - optimal).sum() < 0.5 * gap
    assert stats["p_reward"] == 0.0  # the learned reward alone


def test_a_frozen_policy_keeps_its_actions_and_learns_its_value() -> None:
    learner = critic(learning_rate=0.01)
    actions = legal_actions(SHORT, Goal(GOAL))
    before, value = probabilities(learner, actions), [p.detach().clone() for p in learner.net.value_head.parameters()]
    learner.frozen = True
    sampled, candidates = sample(learner, 32)
    rewards = torch.cat([torch.ones(1), rewards_of(candidates)]).unsqueeze(0)
    learner.update([one_step(actions[0], sampled=sampled)], [rewards])
    assert probabilities(learner, actions) == before
    assert not all(map(torch.equal, learner.net.value_head.parameters(), value))


def test_policy_gradients_raise_rewarded_actions_and_lower_punished_ones() -> None:
    learner = critic(entropy=1e-6, learning_rate=0.01, value_loss_weight=0.0)
    actions = [Action(verb=Verb.CLICK, element=0), Action(verb=Verb.CLICK, element=1)]
    before = probabilities(learner, actions)
    rollouts = [one_step(action, float(np.log(p))) for action, p in zip(actions, before, strict=True)]
    for _ in range(10):
        learner.update(rollouts, [torch.tensor([[5.0]]), torch.tensor([[-5.0]])])
    after = probabilities(learner, actions)
    assert after[0] > before[0] + 0.05
    assert after[1] < before[1] - 0.05


def test_the_value_learns_the_discounted_return() -> None:
    learner = critic(vtrace_weight=0.0, entropy=1e-6, learning_rate=0.01, gamma=0.5)
    action = Action(verb=Verb.CLICK, element=0)
    rollout = featurise_trajectory(trajectory(GOAL, [SHORT, FLAT], [action, action]), vectors())
    batch, actions = collate_steps(steps_of([rollout]))
    for _ in range(120):
        with torch.no_grad():
            logp, _ = learner.net.evaluate(learner.net.encoder(batch), actions)
        on_policy = replace(rollout.trajectory, behaviour_logp=logp[:, 0].numpy())
        learner.update([replace(rollout, trajectory=on_policy)], [torch.tensor([[1.0], [4.0]])])
    with torch.no_grad():
        value = learner.net.state_value(learner.net.encoder(batch))
    assert value.tolist() == pytest.approx([1.0 + 0.5 * 4.0, 4.0], abs=0.3)


def test_an_update_reports_the_mean_reward_per_episode() -> None:
    action = Action(verb=Verb.CLICK, element=0)
    long = featurise_trajectory(trajectory(GOAL, [SHORT, FLAT, SHORT], [action] * 3), vectors())
    stats = critic().update([one_step(action), long], [torch.tensor([[2.0]]), torch.tensor([[1.0], [1.0], [4.0]])])
    assert stats["p_reward"] == pytest.approx(4.0)
    assert all(np.isfinite(value) for value in stats.values())


def test_pad_rows_fills_the_ends_of_short_rows_with_zeros() -> None:
    rows = [np.array([1.0], dtype=np.float32), np.array([2.0, 3.0], dtype=np.float32)]
    assert pad_rows(rows).tolist() == [[1.0, 0.0], [2.0, 3.0]]
