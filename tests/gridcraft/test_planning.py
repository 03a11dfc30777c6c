"""The oracle against policies enumerated, formulas written naively and episodes sampled."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from gridcraft.instructions import Pair
from gridcraft.layouts import LAYOUTS, Layout
from gridcraft.planning import (
    draw_paths,
    expected_return,
    expected_reward,
    normalized_return,
    occupancy,
    random_policy,
    solve,
    solve_horizon,
    steps_to,
)
from gridcraft.world import World, build_world, draw_starts, transitions, true_reward

ROW = build_world([Layout.draw("row", "..RB")])
TO_RED = true_reward(ROW, Pair("red", "blue"))
REGIONS = build_world([LAYOUTS["regions"]])


def table(world: World, seed: int = 0, *, next_state: bool = False) -> NDArray[np.float64]:
    """A random reward."""
    shape = (len(world), 5, len(world)) if next_state else (len(world), 5)
    return np.random.default_rng(seed).normal(size=shape)


def policy(world: World, seed: int = 0) -> NDArray[np.float64]:
    """A random stochastic policy."""
    weight = np.random.default_rng(seed).random((len(world), 5))
    normal: NDArray[np.float64] = weight / weight.sum(axis=1, keepdims=True)
    return normal


def test_values_along_a_row_are_those_worked_out_by_hand() -> None:
    found = solve(ROW, TO_RED, discount=0.9)
    # On red for ever: 1 / (1 - .9) = 10; one step away .9 * 10; on blue -1 first.
    assert found.v == pytest.approx([8.1, 9.0, 10.0, 8.0])
    assert found.pi[0] == pytest.approx([0, 0, 0, 1, 0])  # right
    assert found.pi[2] == pytest.approx([1 / 3, 1 / 3, 0, 0, 1 / 3])  # up, down and stay all stay on red
    assert found.pi[3] == pytest.approx([0, 0, 1, 0, 0])  # left, off blue


def test_with_few_steps_left_the_value_counts_the_steps_on_the_goal() -> None:
    found = solve_horizon(ROW, TO_RED, horizon=3)
    assert found.v.tolist() == [[1, 2, 3, 1], [0, 1, 2, 0], [0, 0, 1, -1]]
    best = expected_return(ROW, found.pi, TO_RED, horizon=3)
    assert best == pytest.approx((1 + 2) / 2)  # starts on either white cell


@pytest.mark.parametrize("slip", [0.0, 0.25])
def test_no_deterministic_policy_beats_the_greedy_optimum(slip: float) -> None:
    world = build_world([Layout.draw("tiny", ".RB")], slip)
    reward = table(world, 4)
    chain = transitions(world)
    best = solve(world, reward, discount=0.8).v
    values = []
    for chosen in itertools.product(range(5), repeat=len(world)):
        index = np.arange(len(world)), np.array(chosen)
        values.append(np.linalg.solve(np.eye(len(world)) - 0.8 * chain[index], reward[index]))
    assert best == pytest.approx(np.max(values, axis=0))


@pytest.mark.parametrize(("slip", "temperature"), [(0.0, 0.1), (0.3, 1.5)])
def test_the_soft_solution_is_the_fixed_point_of_its_naive_equations(slip: float, temperature: float) -> None:
    world = build_world([LAYOUTS["rooms"]], slip)
    reward, chain = table(world), transitions(world)
    found = solve(world, reward, temperature=temperature, discount=0.9)
    for s in range(len(world)):
        for a in range(5):
            assert found.q[s, a] == pytest.approx(reward[s, a] + 0.9 * float(chain[s, a] @ found.v))
            assert found.pi[s, a] == pytest.approx(math.exp((found.q[s, a] - found.v[s]) / temperature))
        total = sum(math.exp(q / temperature) for q in found.q[s])
        assert found.v[s] == pytest.approx(temperature * math.log(total))


def test_the_soft_policy_has_the_most_return_plus_entropy_of_all_that_were_tried() -> None:
    temperature, horizon = 0.5, 6
    reward = table(ROW, 2)

    def objective(pi: NDArray[np.float64]) -> float:
        entropy = -(pi * np.log(pi)).sum(axis=2)
        at = occupancy(ROW, pi, horizon)
        return expected_return(ROW, pi, reward, horizon=horizon) + temperature * float((at * entropy).sum())

    soft = solve_horizon(ROW, reward, temperature=temperature, horizon=horizon)
    best = objective(soft.pi)
    assert best == pytest.approx(float(ROW.start @ soft.v[0]))
    for seed in range(50):
        assert objective(0.9 * soft.pi + 0.1 * policy(ROW, seed)) < best


def test_a_low_temperature_ends_at_the_greedy_solution() -> None:
    reward = table(REGIONS)
    soft, hard = solve(REGIONS, reward, temperature=1e-4), solve(REGIONS, reward)
    assert soft.v == pytest.approx(hard.v, abs=1e-2)
    assert soft.pi == pytest.approx(hard.pi, abs=1e-3)


@pytest.mark.parametrize("scale", [1e-12, 1e6])
def test_the_greedy_policy_does_not_depend_on_the_scale_of_the_reward(scale: float) -> None:
    reward = true_reward(REGIONS, Pair("red", "blue"))
    assert (solve(REGIONS, scale * reward).pi == solve(REGIONS, reward).pi).all()


@pytest.mark.parametrize(("slip", "discount"), [(0.0, 1.0), (0.4, 0.9)])
def test_the_expected_return_is_the_sum_over_every_path(slip: float, discount: float) -> None:
    world = build_world([Layout.draw("tiny", "..R")], slip)
    pi, reward, chain = policy(world), table(world, 1), transitions(world)

    def naive(s: int, steps: int) -> float:
        total = 0.0
        for a in range(5) if steps else ():
            later = sum(chain[s, a, n] * naive(n, steps - 1) for n in range(3))
            total += pi[s, a] * (reward[s, a] + discount * later)
        return total

    expected = (naive(0, 4) + naive(1, 4)) / 2
    assert expected_return(world, pi, reward, horizon=4, discount=discount) == pytest.approx(expected)


def test_a_reward_on_the_next_state_counts_by_where_the_action_leads() -> None:
    world = build_world([Layout.draw("row", "..RB")], slip=0.3)
    reward = table(world, next_state=True)
    by_hand = [[sum(transitions(world)[s, a] * reward[s, a]) for a in range(5)] for s in range(4)]
    assert expected_reward(world, reward) == pytest.approx(np.array(by_hand))
    assert solve(world, reward).v == pytest.approx(solve(world, np.array(by_hand)).v)


def test_visits_are_where_sampled_episodes_are() -> None:
    world = build_world([LAYOUTS["rooms"]], slip=0.1)
    pi, rng = policy(world), np.random.default_rng(0)
    paths = draw_paths(world, pi, draw_starts(world, 20_000, rng), rng, horizon=8)
    exact = occupancy(world, pi, horizon=8)
    assert exact.sum(axis=1) == pytest.approx(1.0)
    for t in (0, 3, 7):
        seen = np.bincount(paths.states[:, t], minlength=len(world)) / 20_000
        assert np.abs(seen - exact[t]).max() < 0.01


def test_demonstrations_follow_the_world_earn_what_was_computed_and_repeat_with_their_seed() -> None:
    reward = true_reward(REGIONS, Pair("red", "blue"))
    expert = solve(REGIONS, reward, temperature=0.1).pi
    starts = draw_starts(REGIONS, 2000, np.random.default_rng(1))
    paths, again = (draw_paths(REGIONS, expert, starts, np.random.default_rng(2)) for _ in range(2))
    assert (paths.states == again.states).all()
    assert (paths.actions == again.actions).all()
    assert paths.states.shape == (2000, 31)
    assert (REGIONS.next_state[paths.states[:, :-1], paths.actions] == paths.states[:, 1:]).all()
    earned = reward[paths.states[:, :-1], paths.actions].sum(axis=1)
    assert abs(earned.mean() - expected_return(REGIONS, expert, reward)) < 4 * earned.std() / math.sqrt(2000)


def test_an_action_without_probability_is_never_drawn() -> None:
    pi = np.zeros((len(ROW), 5))
    pi[:, [1, 3]] = 0.5
    paths = draw_paths(ROW, pi, np.zeros(500, dtype=np.int64), np.random.default_rng(0))
    assert set(paths.actions.ravel().tolist()) == {1, 3}


def test_the_fraction_is_one_for_the_best_and_nought_for_chance_and_linear_between() -> None:
    reward = true_reward(REGIONS, Pair("green", "red"))
    best, chance = solve_horizon(REGIONS, reward).pi, random_policy(REGIONS)
    assert normalized_return(REGIONS, best, reward) == pytest.approx(1.0)
    assert normalized_return(REGIONS, chance, reward) == pytest.approx(0.0)
    assert normalized_return(REGIONS, solve(REGIONS, -reward).pi, reward) < -0.01
    some = policy(REGIONS)
    spans = [expected_return(REGIONS, pi, reward) for pi in (some, best, chance)]
    assert normalized_return(REGIONS, some, reward) == pytest.approx((spans[0] - spans[2]) / (spans[1] - spans[2]))


@pytest.mark.parametrize("pair", [Pair("red", "blue"), Pair("blue", "green")], ids=str)
def test_the_soft_expert_is_all_but_optimal_within_the_horizon(pair: Pair) -> None:
    reward = true_reward(REGIONS, pair)
    assert 0.999 < normalized_return(REGIONS, solve(REGIONS, reward, temperature=0.1).pi, reward) < 1.0


def test_steps_to_a_colour_go_around_walls_and_are_infinite_from_another_layout() -> None:
    world = build_world([Layout.draw("bend", "R#. ..."), Layout.draw("other", "..B")])
    assert steps_to(world, world.colour == 1).tolist() == [0, 4, 1, 2, 3, math.inf, math.inf, math.inf]


def test_tables_of_the_wrong_form_are_refused_with_both_shapes() -> None:
    with pytest.raises(ValueError, match=r"\(3, 5\), wanted \(4, 5\)"):
        solve(ROW, np.zeros((3, 5)))
    with pytest.raises(ValueError, match="not finite"):
        solve(ROW, np.full((4, 5), np.nan))
    with pytest.raises(ValueError, match="do not add up"):
        occupancy(ROW, np.zeros((4, 5)))
    with pytest.raises(ValueError, match="policy for 7 steps"):
        occupancy(ROW, np.full((6, 4, 5), 0.2), horizon=7)
    with pytest.raises(ValueError, match="not 1"):
        solve(ROW, TO_RED, discount=1.0)
    with pytest.raises(ValueError, match="temperature"):
        solve(ROW, TO_RED, temperature=-0.1)
    with pytest.raises(ValueError, match="one to gain by"):
        normalized_return(ROW, random_policy(ROW), np.ones((4, 5)))
