"""Each loss and target is compared with a naive form of its equation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from giirl_core.nets.reward import FORMS, reward_of
from learner.losses import discard_top, gradient_penalty, iq_loss, logistic_loss, sqil_loss, vtrace


def same(one: Tensor, two: Tensor) -> bool:
    """Equal up to rounding in double precision."""
    return torch.allclose(one, two, rtol=1e-9, atol=1e-9)


def normal(*shape: int, seed: int = 0) -> Tensor:
    """Standard normal numbers in double precision."""
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_logistic_loss_with_one_source_is_the_thesis_equation_3_2() -> None:
    expert, rollouts = 3 * normal(7), 3 * normal(5, seed=1)
    D_expert, D_rollouts = 1 / (1 + (-expert).exp()), 1 / (1 + (-rollouts).exp())
    naive = (-(1 - D_rollouts).log()).mean() + (-D_expert.log()).mean()
    assert same(logistic_loss(expert, [(0.3, rollouts)]), naive)


def test_logistic_loss_depends_only_on_the_proportions_of_the_weights() -> None:
    expert, one, two = normal(4), normal(3, seed=1), normal(9, seed=2)
    naive = -torch.sigmoid(expert).log().mean()
    naive = naive - 0.25 * (1 - torch.sigmoid(one)).log().mean() - 0.75 * (1 - torch.sigmoid(two)).log().mean()
    assert same(logistic_loss(expert, [(1.0, one), (3.0, two)]), naive)
    assert same(logistic_loss(expert, [(0.1, one), (0.3, two)]), naive)


def test_the_weight_of_a_source_without_samples_has_no_effect() -> None:
    expert, one = normal(4), normal(3, seed=1)
    assert logistic_loss(expert, [(0.5, one), (9.0, one[:0])]) == logistic_loss(expert, [(1.0, one)])


def test_logistic_loss_is_finite_where_the_naive_formula_overflows() -> None:
    assert logistic_loss(torch.tensor([-200.0]), [(1.0, torch.tensor([300.0]))]).item() == pytest.approx(500.0)


@given(st.floats(-4.9, 4.9))
def test_reward_forms_equal_their_formulas_in_d(logit: float) -> None:
    D = 1 / (1 + math.exp(-logit))
    x = torch.tensor(logit, dtype=torch.float64)
    assert reward_of(x, "logit", 5.0).item() == pytest.approx(math.log(D) - math.log(1 - D), abs=1e-9)
    assert reward_of(x, "d", 5.0).item() == pytest.approx(D)
    assert reward_of(x, "log_d", 5.0).item() == pytest.approx(math.log(D))
    assert reward_of(x, "gail", 5.0).item() == pytest.approx(-math.log(1 - D))
    assert reward_of(x, "goal", 5.0).item() == float(logit > 0)


@pytest.mark.parametrize("form", FORMS)
def test_clipping_the_logit_bounds_every_reward_form(form: str) -> None:
    far, edge = torch.tensor([-50.0, 50.0]), torch.tensor([-2.0, 2.0])
    assert torch.equal(reward_of(far, form, 2.0), reward_of(edge, form, 2.0))


def test_the_error_for_an_unknown_reward_form_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match="'lodgit': wanted one of logit, d, log_d, gail, goal"):
        reward_of(torch.zeros(1), "lodgit", 5.0)


def slow_vtrace(
    ratio: list[float], rewards: list[float], values: list[float], gamma: float, clip: float
) -> tuple[list[float], list[float]]:
    """Eq. 1 of Espeholt et al. (2018) for one complete episode, as printed: a sum over t of a product over i."""
    T = len(rewards)
    V = [*values, 0.0]
    rho = [min(clip, r) for r in ratio]
    c = [min(1.0, clip, r) for r in ratio]
    v = []
    for s in range(T):
        total = V[s]
        for t in range(s, T):
            delta = rho[t] * (rewards[t] + gamma * V[t + 1] - V[t])
            total += gamma ** (t - s) * math.prod(c[s:t]) * delta
        v.append(total)
    v.append(0.0)
    return v[:T], [rho[s] * (rewards[s] + gamma * v[s + 1] - V[s]) for s in range(T)]


@settings(max_examples=50)
@given(
    lengths=st.lists(st.integers(1, 5), min_size=1, max_size=4),
    gamma=st.floats(0, 1),
    clip=st.floats(0.2, 3),
    seed=st.integers(0, 99),
)
def test_vtrace_equals_the_printed_formula_for_episodes_of_any_length(
    lengths: list[int], gamma: float, clip: float, seed: int
) -> None:
    shape = (len(lengths), max(lengths))
    logp, behaviour, rewards, values = (normal(*shape, seed=4 * seed + i) for i in range(4))
    mask = torch.arange(shape[1]) < torch.tensor(lengths).unsqueeze(1)
    targets, advantages = vtrace(logp, behaviour, rewards, values, mask, gamma, clip)
    for b, n in enumerate(lengths):
        ratio = (logp - behaviour).exp()[b, :n].tolist()
        v, a = slow_vtrace(ratio, rewards[b, :n].tolist(), values[b, :n].tolist(), gamma, clip)
        np.testing.assert_allclose(targets[b, :n].numpy(), v, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(advantages[b, :n].numpy(), a, rtol=1e-9, atol=1e-9)
    assert not targets[~mask].any()
    assert not advantages[~mask].any()


def test_on_policy_vtrace_targets_are_the_discounted_returns() -> None:
    logp, rewards, values = normal(3, 6), normal(3, 6, seed=1), normal(3, 6, seed=2)
    targets, advantages = vtrace(logp, logp, rewards, values, torch.ones(3, 6, dtype=torch.bool), 0.9, 1.0)
    for t in range(6):
        returns = sum(0.9 ** (k - t) * rewards[:, k] for k in range(t, 6))
        assert same(targets[:, t], torch.as_tensor(returns))
        assert same(advantages[:, t], returns - values[:, t])


def test_gradient_penalty_is_the_squared_norm_of_the_gradient_of_a_known_function() -> None:
    weights, x = normal(6), normal(4, 6, seed=1).requires_grad_()
    logits = (x.pow(2) * weights).sum(1)  # its gradient is 2 w x
    expected = (2 * weights * x).pow(2).sum(1).mean()
    assert same(gradient_penalty(logits, [x]), expected)


def test_gradient_penalty_sums_over_inputs_and_is_differentiable() -> None:
    net = nn.Sequential(nn.Linear(3, 5), nn.Tanh(), nn.Linear(5, 1)).double()
    x, y = normal(4, 3).requires_grad_(), normal(4, 3, seed=1).requires_grad_()

    def logit(a: Tensor, b: Tensor) -> Tensor:
        out: Tensor = net(a).squeeze() * net(b).squeeze()
        return out

    rows = []
    for i in range(4):
        one, two = x[i : i + 1].detach().requires_grad_(), y[i : i + 1].detach().requires_grad_()
        logit(one, two).backward()
        assert one.grad is not None
        assert two.grad is not None
        rows.append(one.grad.pow(2).sum() + two.grad.pow(2).sum())
    net.zero_grad()
    penalty = gradient_penalty(logit(x, y), [x, y])
    assert same(penalty, torch.stack(rows).mean())
    penalty.backward()
    assert all(p.grad is not None and p.grad.abs().sum() > 0 for p in net[0].parameters())


def test_sqil_has_reward_1_for_the_expert_and_0_for_the_policy() -> None:
    expert, rollouts = torch.tensor([0.5, 2.0]), torch.tensor([0.25, -1.0, 0.0])
    naive = (0.25 + 1.0) / 2 + (0.0625 + 1.0 + 0.0) / 3
    assert sqil_loss(expert, rollouts).item() == pytest.approx(naive)
    assert sqil_loss(torch.ones(3), torch.zeros(5)).item() == 0.0


def test_iq_loss_equals_the_naive_form_of_its_objective() -> None:
    expert, rollouts = torch.tensor([0.3, -0.2]), torch.tensor([0.1])
    value_drop = torch.tensor([0.5, 0.7, 0.9])
    naive = (0.5 + 0.7 + 0.9) / 3 - (0.3 - 0.2) / 2 + (0.09 + 0.04 + 0.01) / 3 / (4 * 0.5)
    assert iq_loss(expert, rollouts, value_drop, 0.5).item() == pytest.approx(naive)


def test_discard_top_removes_the_highest_logits() -> None:
    logits = torch.tensor([3.0, -1.0, 2.0, 0.0])
    assert sorted(discard_top(logits, 0.25).tolist()) == [-1.0, 0.0, 2.0]
    assert torch.equal(discard_top(logits, 0.0), logits)
    assert torch.equal(discard_top(logits, 0.2), logits)  # 0.2 of four logits is less than one
