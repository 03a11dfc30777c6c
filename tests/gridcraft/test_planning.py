"""The planner agrees with enumerated policies, naive formulas and sampled episodes."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gridcraft.instructions import ColourPair
from gridcraft.layouts import LAYOUTS, Layout
from gridcraft.planning import (
    distance_to,
    expected_return,
    expected_reward,
    normalized_return,
    occupancy,
    random_policy,
    sample_trajectories,
    solve,
    solve_horizon,
)
from gridcraft.world import World, build_world, sample_starts, transitions, true_reward

ROW = build_world([Layout.parse("row", "..RB")])
TO_RED = true_reward(ROW, ColourPair("red", "blue"))
REGIONS = build_world([LAYOUTS["regions"]])


def table(world: World, seed: int = 0, *, next_state: bool = False) -> NDArray[np.float64]:
    """A random reward table."""
    shape = (len(world), 5, len(world)) if next_state else (len(world), 5)
    return np.random.default_rng(seed).normal(size=shape)


def policy(world: World, seed: int = 0) -> NDArray[np.float64]:
    """A random stochastic policy."""
    weight = np.random.default_rng(seed).random((len(world), 5))
    normal: NDArray[np.float64] = weight / weight.sum(axis=1, keepdims=True)
    return normal


def test_values_along_a_row_match_values_computed_by_hand() -> None:
    found = solve(ROW, TO_RED, discount=0.9)
    # Staying on red: 1 / (1 - .9) = 10. One step away: .9 * 10. On blue: -1 + .9 * 10.
    assert found.v == pytest.approx([8.1, 9.0, 10.0, 8.0])
    assert found.pi[0] == pytest.approx([0, 0, 0, 1, 0])  # right
    assert found.pi[2] == pytest.approx([1 / 3, 1 / 3, 0, 0, 1 / 3])  # up, down and stay all keep the agent on red
    assert found.pi[3] == pytest.approx([0, 0, 1, 0, 0])  # left, off blue


def test_the_finite_horizon_value_counts_the_remaining_steps_on_the_goal() -> None:
    found = solve_horizon(ROW, TO_RED, horizon=3)
    assert found.v.tolist() == [[1, 2, 3, 1], [0, 1, 2, 0], [0, 0, 1, -1]]
    best = expected_return(ROW, found.pi, TO_RED, horizon=3)
    assert best == pytest.approx((1 + 2) / 2)  # starts on either white cell with equal probability


@pytest.mark.parametrize("slip", [0.0, 0.25])
def test_the_greedy_optimum_equals_the_best_deterministic_policy(slip: float) -> None:
    world = build_world([Layout.parse("tiny", ".RB")], slip)
    reward = table(world, 4)
    chain = transitions(world)
    best = solve(world, reward, discount=0.8).v
    values = []
    for chosen in itertools.product(range(5), repeat=len(world)):
        index = np.arange(len(world)), np.array(chosen)
        values.append(np.linalg.solve(np.eye(len(world)) - 0.8 * chain[index], reward[index]))
    assert best == pytest.approx(np.max(values, axis=0))


@pytest.mark.parametrize(("slip", "temperature"), [(0.0, 0.1), (0.3, 1.5)])
def test_the_soft_solution_is_a_fixed_point_of_the_soft_bellman_equations(slip: float, temperature: float) -> None:
    world = build_world([LAYOUTS["rooms"]], slip)
    reward, chain = table(world), transitions(world)
    found = solve(world, reward, temperature=temperature, discount=0.9)
    for s in range(len(world)):
        for a in range(5):
            assert found.q[s, a] == pytest.approx(reward[s, a] + 0.9 * float(chain[s, a] @ found.v))
            assert found.pi[s, a] == pytest.approx(math.exp((found.q[s, a] - found.v[s]) / temperature))
        total = sum(math.exp(q / temperature) for q in found.q[s])
        assert found.v[s] == pytest.approx(temperature * math.log(total))


def test_the_soft_policy_maximises_return_plus_entropy() -> None:
    temperature, horizon = 0.5, 6
    reward = table(ROW, 2)

    def objective(pi: NDArray[np.float64]) -> float:
        entropy = -(pi * np.log(pi)).sum(axis=2)
        visits = occupancy(ROW, pi, horizon)
        return expected_return(ROW, pi, reward, horizon=horizon) + temperature * float((visits * entropy).sum())

    soft = solve_horizon(ROW, reward, temperature=temperature, horizon=horizon)
    best = objective(soft.pi)
    assert best == pytest.approx(float(ROW.start @ soft.v[0]))
    for seed in range(50):
        assert objective(0.9 * soft.pi + 0.1 * policy(ROW, seed)) < best


def test_a_low_temperature_gives_the_greedy_solution() -> None:
    reward = table(REGIONS)
    soft, hard = solve(REGIONS, reward, temperature=1e-4), solve(REGIONS, reward)
    assert soft.v == pytest.approx(hard.v, abs=1e-2)
    assert soft.pi == pytest.approx(hard.pi, abs=1e-3)


@pytest.mark.parametrize("scale", [1e-12, 1e6])
def test_the_greedy_policy_does_not_depend_on_the_scale_of_the_reward(scale: float) -> None:
    reward = true_reward(REGIONS, ColourPair("red", "blue"))
    assert (solve(REGIONS, scale * reward).pi == solve(REGIONS, reward).pi).all()


@pytest.mark.parametrize(("slip", "discount"), [(0.0, 1.0), (0.4, 0.9)])
def test_the_expected_return_is_the_sum_over_all_trajectories(slip: float, discount: float) -> None:
    world = build_world([Layout.parse("tiny", "..R")], slip)
    pi, reward, chain = policy(world), table(world, 1), transitions(world)

    def naive(s: int, steps: int) -> float:
        total = 0.0
        for a in range(5) if steps else ():
            later = sum(chain[s, a, n] * naive(n, steps - 1) for n in range(3))
            total += pi[s, a] * (reward[s, a] + discount * later)
        return total

    expected = (naive(0, 4) + naive(1, 4)) / 2
    assert expected_return(world, pi, reward, horizon=4, discount=discount) == pytest.approx(expected)


def test_a_reward_on_next_states_is_averaged_over_the_transition_probabilities() -> None:
    world = build_world([Layout.parse("row", "..RB")], slip=0.3)
    reward = table(world, next_state=True)
    by_hand = [[sum(transitions(world)[s, a] * reward[s, a]) for a in range(5)] for s in range(4)]
    assert expected_reward(world, reward) == pytest.approx(np.array(by_hand))
    assert solve(world, reward).v == pytest.approx(solve(world, np.array(by_hand)).v)


def test_occupancy_matches_the_frequencies_of_sampled_episodes() -> None:
    world = build_world([LAYOUTS["rooms"]], slip=0.1)
    pi, rng = policy(world), np.random.default_rng(0)
    sampled = sample_trajectories(world, pi, sample_starts(world, 20_000, rng), rng, horizon=8)
    exact = occupancy(world, pi, horizon=8)
    assert exact.sum(axis=1) == pytest.approx(1.0)
    for t in (0, 3, 7):
        frequency = np.bincount(sampled.states[:, t], minlength=len(world)) / 20_000
        assert np.abs(frequency - exact[t]).max() < 0.01


def test_sampled_demonstrations_obey_transitions_expected_return_and_seed() -> None:
    reward = true_reward(REGIONS, ColourPair("red", "blue"))
    expert = solve(REGIONS, reward, temperature=0.1).pi
    starts = sample_starts(REGIONS, 2000, np.random.default_rng(1))
    sampled, again = (sample_trajectories(REGIONS, expert, starts, np.random.default_rng(2)) for _ in range(2))
    assert (sampled.states == again.states).all()
    assert (sampled.actions == again.actions).all()
    assert sampled.states.shape == (2000, 31)
    assert (REGIONS.next_state[sampled.states[:, :-1], sampled.actions] == sampled.states[:, 1:]).all()
    returns = reward[sampled.states[:, :-1], sampled.actions].sum(axis=1)
    assert abs(returns.mean() - expected_return(REGIONS, expert, reward)) < 4 * returns.std() / math.sqrt(2000)


def test_actions_with_probability_zero_are_never_sampled() -> None:
    pi = np.zeros((len(ROW), 5))
    pi[:, [1, 3]] = 0.5
    sampled = sample_trajectories(ROW, pi, np.zeros(500, dtype=np.int64), np.random.default_rng(0))
    assert set(sampled.actions.ravel().tolist()) == {1, 3}


def test_the_normalized_return_is_1_for_the_optimum_0_for_random_and_linear_in_between() -> None:
    reward = true_reward(REGIONS, ColourPair("green", "red"))
    best, random = solve_horizon(REGIONS, reward).pi, random_policy(REGIONS)
    assert normalized_return(REGIONS, best, reward) == pytest.approx(1.0)
    assert normalized_return(REGIONS, random, reward) == pytest.approx(0.0)
    assert normalized_return(REGIONS, solve(REGIONS, -reward).pi, reward) < -0.01
    other = policy(REGIONS)
    got, high, low = (expected_return(REGIONS, pi, reward) for pi in (other, best, random))
    assert normalized_return(REGIONS, other, reward) == pytest.approx((got - low) / (high - low))


@pytest.mark.parametrize("pair", [ColourPair("red", "blue"), ColourPair("blue", "green")], ids=str)
def test_the_soft_expert_is_almost_optimal_within_the_horizon(pair: ColourPair) -> None:
    reward = true_reward(REGIONS, pair)
    assert 0.999 < normalized_return(REGIONS, solve(REGIONS, reward, temperature=0.1).pi, reward) < 1.0


def test_distances_go_around_walls_and_are_infinite_between_layouts() -> None:
    world = build_world([Layout.parse("bend", "R#. ..."), Layout.parse("other", "..B")])
    assert distance_to(world, world.colour == 1).tolist() == [0, 4, 1, 2, 3, math.inf, math.inf, math.inf]


def test_illegal_tables_and_parameters_are_errors() -> None:
    with pytest.raises(ValueError, match=r"\(3, 5\), wanted \(4, 5\)"):
        solve(ROW, np.zeros((3, 5)))
    with pytest.raises(ValueError, match="not finite"):
        solve(ROW, np.full((4, 5), np.nan))
    with pytest.raises(ValueError, match="do not add up"):
        occupancy(ROW, np.zeros((4, 5)))
    with pytest.raises(ValueError, match="policy for 7 steps"):
        occupancy(ROW, np.full((6, 4, 5), 0.2), horizon=7)
    with pytest.raises(ValueError, match="below 1"):
        solve(ROW, TO_RED, discount=1.0)
    with pytest.raises(ValueError, match="temperature"):
        solve(ROW, TO_RED, temperature=-0.1)
    with pytest.raises(ValueError, match="separates policies"):
        normalized_return(ROW, random_policy(ROW), np.ones((4, 5)))
