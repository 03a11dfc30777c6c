"""What an update does to the policy: towards what pays, and towards the soft-optimal choice among what it asked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from giirl_core.config import PolicyConfig
from giirl_core.metrics import Metrics
from giirl_core.nets.features import ActionBatch, Batch
from giirl_core.types import Action, Goal, Verb
from learner.actor_critic import ActorCritic
from learner.data import Example, collate_steps, featurise_trajectory, pad, steps_of
from tests.learner.samples import FLAT, SHORT, legal_actions, policy, trajectory, vectors

GOAL = "Type ok."
ALPHA = 0.5


def critic(**settings: float) -> ActorCritic:
    """A small one with a seed."""
    config = replace(PolicyConfig(), **settings)  # type: ignore[arg-type]
    return ActorCritic(config, policy(), torch.Generator().manual_seed(0), metrics=Metrics())


def fond(batch: Batch, actions: ActionBatch) -> Tensor:
    """A made-up reward of every action, between -1 and 1."""
    return torch.sin(2.0 * actions.verb + 3.0 * actions.element + 5.0 * actions.start + 7.0 * actions.end)


def one_step(action: Action, logp: float = 0.0) -> Example:
    """A rollout that did one thing on the short page."""
    done = trajectory(GOAL, [SHORT], [action])
    return featurise_trajectory(replace(done, behaviour_logp=np.array([logp], dtype=np.float32)), vectors())


def likelihoods(learner: ActorCritic, actions: list[Action]) -> list[float]:
    """How likely the policy is to do each on the short page."""
    batch, together = collate_steps(steps_of([one_step(action) for action in actions]))
    with torch.no_grad():
        logp, _, _ = learner.net.evaluate(batch, together)
    return [float(p) for p in logp.squeeze(1).exp()]


def test_the_soft_optimal_choice_among_many_asked_is_that_of_the_enumeration() -> None:
    learner = critic(sampled_actions=3_000, entropy=ALPHA)
    batch, taken = collate_steps(steps_of([one_step(Action(verb=Verb.CLICK, element=0))]))
    joined, target = learner._sample_targets(batch, taken, fond)
    assert joined.element.shape == (1, 3_001)
    assert target.sum().item() == pytest.approx(1.0, abs=1e-4)
    actions = legal_actions(SHORT, Goal(GOAL))
    _, each = collate_steps(steps_of([one_step(action) for action in actions]))
    optimal = (fond(batch, each) / ALPHA).squeeze(1).softmax(0)
    for action, p in zip(actions, optimal.tolist(), strict=True):
        same = (joined.verb == action.verb) & (joined.element == action.element)
        same &= (joined.start == action.start) & (joined.end == action.end)
        assert target[same[:, 1:]].sum().item() == pytest.approx(p, abs=0.04)


def test_half_of_what_is_asked_is_chance_so_that_nothing_stays_unasked() -> None:
    learner = critic(sampled_actions=400)
    with torch.no_grad():  # a policy that is sure to click
        learner.net.act[2].bias.copy_(torch.tensor([20.0, -20.0]))  # type: ignore[operator]
    batch, taken = collate_steps(steps_of([one_step(Action(verb=Verb.CLICK, element=0))]))
    joined, _ = learner._sample_targets(batch, taken, fond)
    verbs = joined.verb[0, 1:]
    assert not verbs[0::2].any()
    assert 0.2 < verbs[1::2].float().mean() < 0.5  # two leaves to click, one field to type into


def test_a_policy_that_never_saw_a_good_action_learns_it_by_asking() -> None:
    learner = critic(vtrace_weight=0.0, learning_rate=0.01)
    bad, good = Action(verb=Verb.CLICK, element=1), Action(verb=Verb.TYPE, element=1, start=1, end=1)

    def reward_fn(batch: Batch, actions: ActionBatch) -> Tensor:
        right = (actions.verb == good.verb) & (actions.start == good.start) & (actions.end == good.end)
        return torch.where(right, 2.0, -2.0)

    for _ in range(40):
        learner.update([one_step(bad)], [torch.zeros(1)], reward_fn)
    assert likelihoods(learner, [good])[0] > 0.8


def test_actions_taken_become_likelier_when_they_pay_and_rarer_when_they_cost() -> None:
    learner = critic(sampled_actions=0, entropy=1e-6, learning_rate=0.01, value_loss_weight=0.0)
    paid, cost = Action(verb=Verb.CLICK, element=0), Action(verb=Verb.CLICK, element=1)
    before = likelihoods(learner, [paid, cost])
    rollouts = [one_step(action, float(np.log(p))) for action, p in zip([paid, cost], before, strict=True)]
    for _ in range(10):
        learner.update(rollouts, [torch.tensor([5.0]), torch.tensor([-5.0])], fond)
    after = likelihoods(learner, [paid, cost])
    assert after[0] > before[0] + 0.05
    assert after[1] < before[1] - 0.05


def test_the_value_learns_the_discounted_reward_to_come() -> None:
    learner = critic(sampled_actions=0, vtrace_weight=0.0, entropy=1e-6, learning_rate=0.01, gamma=0.5)
    action = Action(verb=Verb.CLICK, element=0)
    done = featurise_trajectory(trajectory(GOAL, [SHORT, FLAT], [action, action]), vectors())
    batch, together = collate_steps(steps_of([done]))
    for _ in range(120):
        with torch.no_grad():
            logp, _, _ = learner.net.evaluate(batch, together)
        on_policy = replace(done.trajectory, behaviour_logp=logp[:, 0].numpy())
        learner.update([Example(on_policy, done.features)], [torch.tensor([1.0, 4.0])], fond)
    with torch.no_grad():
        _, _, value = learner.net.evaluate(batch, together)
    assert value.tolist() == pytest.approx([1.0 + 0.5 * 4.0, 4.0], abs=0.3)


def test_an_update_with_rollouts_of_different_lengths_reports_the_mean_pay_of_an_episode() -> None:
    action = Action(verb=Verb.CLICK, element=0)
    long = featurise_trajectory(trajectory(GOAL, [SHORT, FLAT, SHORT], [action] * 3), vectors())
    stats = critic().update([one_step(action), long], [torch.tensor([2.0]), torch.tensor([1.0, 1.0, 4.0])], fond)
    assert stats["p_reward"] == pytest.approx(4.0)
    assert all(np.isfinite(value) for value in stats.values())


def test_padding_a_table_of_steps_fills_zeros_past_every_end() -> None:
    rows = [np.array([1.0], dtype=np.float32), np.array([2.0, 3.0], dtype=np.float32)]
    assert pad(rows).tolist() == [[1.0, 0.0], [2.0, 3.0]]
