"""Each metric agrees with small cases computed by hand and with rewards of known quality."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from giirl.statistics import goal_sensitivity
from gridcraft.instructions import ColourPair
from gridcraft.layouts import LAYOUTS, Layout, random_layout
from gridcraft.planning import normalized_return, random_policy, sample_trajectories, solve
from gridcraft.reward_metrics import (
    auc,
    avoid_rank,
    canonical,
    epic_distance,
    matched_avoid_rank,
    pearson,
    ranks,
    reoptimise,
    spearman,
    state_mean,
    value_correlation,
    violation_rate,
)
from gridcraft.world import World, build_world, true_reward

Array = NDArray[np.float64]

REGIONS = build_world([LAYOUTS["regions"]])
RED_NOT_BLUE = ColourPair("red", "blue")
TRUE = true_reward(REGIONS, RED_NOT_BLUE)
BEST = solve(REGIONS, TRUE).v
VALUE = np.repeat(BEST[:, None], 5, axis=1)


def noise(*shape: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=shape)


def shaped(reward: Array, potential: Array, discount: float) -> Array:
    """[S, A, S'] R + g phi(s') - phi(s)."""
    return reward[:, :, None] + discount * potential[None, None, :] - potential[:, None, None]


def test_equal_values_share_their_mean_rank() -> None:
    assert ranks(np.array([30.0, 10.0, 20.0, 10.0])).tolist() == [4, 1.5, 3, 1.5]
    assert ranks(np.array([0.1 + 0.2, 0.3, 0.0])).tolist() == [2.5, 2.5, 1]
    assert ranks(np.zeros(3)).tolist() == [2, 2, 2]


def test_correlations_match_values_computed_by_hand() -> None:
    x, y = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 3.0, 2.0, 10.0])
    assert spearman(x, y) == pytest.approx(1 - 6 * (0 + 1 + 1 + 0) / (4 * (16 - 1)))
    assert pearson(x, y) == pytest.approx(13 / math.sqrt(5 * 50))
    assert pearson(x, -2 * x + 7) == pytest.approx(-1)
    assert spearman(x, np.exp(5 * x)) == pytest.approx(1)


def test_a_correlation_with_a_constant_is_nan() -> None:
    assert math.isnan(pearson(np.full(9, 0.1), noise(9)))
    assert math.isnan(spearman(noise(9), np.zeros(9)))
    assert math.isnan(epic_distance(np.ones((4, 5)), noise(4, 5)))


def test_the_optimal_value_correlates_fully_with_itself_and_weakly_with_the_sparse_reward() -> None:
    of_value = value_correlation(REGIONS, VALUE, BEST)
    assert (of_value.spearman, of_value.pearson) == pytest.approx((1, 1))
    assert value_correlation(REGIONS, TRUE, BEST).spearman == pytest.approx(0.44, abs=0.005)


def test_random_rewards_have_no_mean_correlation_and_a_large_epic_distance() -> None:
    random = [noise(len(REGIONS), 5, seed=seed) for seed in range(40)]
    correlations = [value_correlation(REGIONS, reward, BEST).spearman for reward in random]
    assert abs(np.mean(correlations)) < 0.06
    assert 0.05 < np.mean(np.abs(correlations)) < 0.2
    assert [epic_distance(reward, TRUE) for reward in random] == pytest.approx([0.5**0.5] * 40, abs=0.07)


def test_the_canonical_reward_matches_the_naive_formula() -> None:
    R, g = noise(4, 5, 4), 0.9
    S, A = range(4), range(5)
    C = canonical(R, g)
    for s, a, n in itertools.product(S, A, S):
        mean_next = np.mean([R[n, b, m] for b in A for m in S])
        mean_here = np.mean([R[s, b, m] for b in A for m in S])
        mean_all = np.mean([R[m, b, k] for m in S for b in A for k in S])
        assert C[s, a, n] == pytest.approx(R[s, a, n] + g * mean_next - mean_here - g * mean_all)


@given(st.integers(0, 1000), st.floats(0, 0.99), st.floats(0.01, 100))
def test_epic_ignores_shaping_scale_and_constants(seed: int, discount: float, scale: float) -> None:
    reward, other = noise(6, 5, seed=seed), noise(6, 5, seed=seed + 1)
    same = scale * shaped(reward, noise(6, seed=seed + 2), discount) + 3.0
    assert epic_distance(same, reward, discount) == pytest.approx(0, abs=1e-6)
    assert epic_distance(same, other, discount) == pytest.approx(epic_distance(reward, other, discount), abs=1e-6)
    assert epic_distance(-same, reward, discount) == pytest.approx(1, abs=1e-6)


def test_epic_matches_its_pearson_formula_and_is_nan_for_pure_shaping() -> None:
    one, other = noise(6, 5), noise(6, 5, seed=1)
    rho = np.corrcoef(canonical(one).ravel(), canonical(other).ravel())[0, 1]
    assert epic_distance(one, other) == pytest.approx(math.sqrt((1 - rho) / 2))
    assert epic_distance(other, one) == pytest.approx(epic_distance(one, other))
    assert math.isnan(epic_distance(shaped(np.zeros((6, 5)), noise(6), 0.95), one))


def test_the_epic_distance_of_the_sparse_reward_is_0_to_itself_and_half_to_its_value() -> None:
    assert epic_distance(TRUE, TRUE) == 0
    assert epic_distance(VALUE, TRUE) == pytest.approx(0.51, abs=0.005)


def reoptimised_return(world: World, learned: Array, true: Array) -> float:
    """The normalised true return of the policy re-optimised on the learned reward."""
    return normalized_return(world, reoptimise(world, learned), true)


def test_reoptimising_the_true_reward_or_its_value_is_optimal() -> None:
    for reward in (TRUE, 7 * TRUE, shaped(TRUE, noise(len(REGIONS)), 0.95)):
        assert reoptimised_return(REGIONS, reward, TRUE) == pytest.approx(1)
    assert reoptimised_return(REGIONS, VALUE, TRUE) == pytest.approx(1)
    assert reoptimised_return(REGIONS, np.zeros_like(TRUE), TRUE) == pytest.approx(0)
    assert reoptimised_return(REGIONS, true_reward(REGIONS, ColourPair("green", "blue")), TRUE) < 0.03
    assert reoptimised_return(REGIONS, -TRUE, TRUE) < -0.1


def test_the_auc_is_the_fraction_of_correctly_ordered_pairs() -> None:
    positive, negative = np.array([3.0, 1.0, 2.0]), np.array([1.0, 0.0, 2.0, 5.0])
    naive = np.mean([(h > x) + 0.5 * (h == x) for h in positive for x in negative])
    assert auc(positive, negative) == pytest.approx(naive)
    assert auc(positive, positive) == pytest.approx(0.5)
    with pytest.raises(ValueError, match="at least one of each"):
        auc(positive, np.array([]))


def test_goal_sensitivity_is_1_for_a_reward_that_depends_on_the_goal_and_half_otherwise() -> None:
    right = noise(300)
    assert goal_sensitivity(right + 10, right) == 1
    assert goal_sensitivity(right, right) == pytest.approx(0.5)
    assert goal_sensitivity(right, noise(300, seed=1)) == pytest.approx(0.5, abs=0.07)
    others = np.stack([right - 0.01, right + 0.01, right], axis=1)
    assert goal_sensitivity(right, others) == pytest.approx((1 + 0 + 0.5) / 3)
    assert goal_sensitivity(right, right - 0.01) == 1
    table, other = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[0.0, 2.0], [5.0, 9.0]])
    assert goal_sensitivity(table, other, np.array([[3.0, 2.0], [1.0, 0.0]])) == pytest.approx((3 + 2 / 2) / 6)


def test_the_state_mean_is_over_actions() -> None:
    reward = np.zeros((3, 5))
    reward[1, 3], reward[1, 2], reward[2, 4], reward[0, 3] = -4, 2, 9, 1
    assert state_mean(reward) == pytest.approx([1 / 5, -2 / 5, 9 / 5])


def test_the_avoid_rank_counts_the_neutral_cells_with_a_higher_score() -> None:
    world = build_world([Layout.parse("row", "R..BB.")])
    score = np.array([9.0, 3.0, 1.0, 2.0, 0.0, 0.0])
    # Blue at 2.0: one of three neutral cells is higher. Blue at 0.0: two are higher, one is equal.
    assert avoid_rank(world, score, RED_NOT_BLUE) == pytest.approx((1 + 2.5) / 6)
    assert avoid_rank(REGIONS, state_mean(TRUE), RED_NOT_BLUE) == 1
    assert avoid_rank(REGIONS, -state_mean(TRUE), RED_NOT_BLUE) == 0
    assert avoid_rank(REGIONS, np.zeros(len(REGIONS)), RED_NOT_BLUE) == 0.5


def test_at_equal_distance_the_optimal_value_ranks_every_avoided_cell_last() -> None:
    value = solve(REGIONS, TRUE).v
    assert matched_avoid_rank(REGIONS, value, RED_NOT_BLUE) == 1
    assert avoid_rank(REGIONS, value, RED_NOT_BLUE) < 0.8  # blue is nearer to red than many white cells
    toward_goal = solve(REGIONS, np.maximum(TRUE, 0)).v
    assert matched_avoid_rank(REGIONS, toward_goal, RED_NOT_BLUE) == 0.5
    row = build_world([Layout.parse("row", "R.B")])
    assert math.isnan(matched_avoid_rank(row, np.zeros(3), RED_NOT_BLUE))


def test_avoided_cells_are_matched_only_with_neutral_cells_of_their_own_layout() -> None:
    first, second = Layout.parse("first", "R.. .B."), Layout.parse("second", "R.. ..B")
    world = build_world([first, second])
    #                 R  .  .  .  B  .    R  .  .  .  .  B
    score = np.array([0, 0, 5, 0, 3, 0, 0, 0, -9, 0, -9, 0], dtype=np.float64)
    # First layout: blue and the white cell with score 5 are both 2 steps from red. Second: only blue is 3 steps away.
    assert matched_avoid_rank(world, score, RED_NOT_BLUE) == 1


def test_the_violation_rate_is_exact() -> None:
    world = build_world([Layout.parse("row", ".BR")])
    right = np.zeros((3, 5))
    right[:, 3] = 1
    assert violation_rate(world, right, RED_NOT_BLUE, horizon=4) == pytest.approx(1)
    assert violation_rate(world, right, RED_NOT_BLUE, horizon=1) == 0
    # The random policy moves right with probability 1/5. The fourth action is taken after three moves.
    assert violation_rate(world, random_policy(world), RED_NOT_BLUE, horizon=4) == pytest.approx(1 - 0.8**3)


@pytest.mark.parametrize("slip", [0.0, 0.2])
def test_the_violation_rate_matches_sampled_episodes(slip: float) -> None:
    world = build_world([random_layout(0)], slip)
    pi, rng = random_policy(world), np.random.default_rng(0)
    starts = rng.choice(len(world), size=20_000, p=world.start)
    on_blue = world.colour[sample_trajectories(world, pi, starts, rng, horizon=12).states[:, :-1]] == 3
    assert violation_rate(world, pi, RED_NOT_BLUE, 12) == pytest.approx(on_blue.any(axis=1).mean(), abs=0.015)
