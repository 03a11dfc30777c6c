"""Exact planning in LanguageGridCraft: value iteration, expected returns, occupancy, and sampled trajectories."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridcraft.world import ACTIONS, DISCOUNT, HORIZON, World, expected_value, step, transitions

Array = NDArray[np.float64]

TOLERANCE = 1e-12  # remaining error of value iteration, relative to the largest value
TIE = 1e-9  # actions within this fraction of max |Q| of the best one are optimal too and share its probability


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """The optimum for one reward: stationary, or for a finite horizon with a leading time axis T."""

    q: Array  # [(T,) S, A]
    v: Array  # [(T,) S]
    pi: Array  # [(T,) S, A] probabilities


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectories:
    """N episodes of T steps."""

    states: NDArray[np.int64]  # [N, T + 1] the state of each action, then the final state
    actions: NDArray[np.int64]  # [N, T]


def expected_reward(world: World, reward: Array) -> Array:
    """[S, A] from r [S, A] or r [S, A, S'], averaged over the next state. ValueError for other shapes or values."""
    shape = (len(world), len(ACTIONS))
    if reward.shape not in (shape, (*shape, len(world))):
        raise ValueError(f"a reward table has shape {reward.shape}, wanted {shape} or {(*shape, len(world))}")
    if not np.isfinite(reward).all():
        raise ValueError("a reward table holds values that are not finite")
    r = reward.astype(np.float64)
    return r if r.ndim == 2 else np.einsum("sat,sat->sa", transitions(world), r)


def soft_backup(q: Array, temperature: float) -> tuple[Array, Array]:
    """v [S] and pi [S, A] from Q [S, A] at temperature tau: v = tau log sum_a exp(Q / tau), pi = softmax(Q / tau).

    At tau = 0: v = max_a Q, and pi is uniform over the optimal actions.
    """
    best = q.max(axis=1, keepdims=True)
    if temperature == 0.0:
        optimal = (q >= best - TIE * np.abs(q).max()).astype(np.float64)
        return best[:, 0], optimal / optimal.sum(axis=1, keepdims=True)
    weight = np.exp((q - best) / temperature)
    total = weight.sum(axis=1, keepdims=True)
    return (best + temperature * np.log(total))[:, 0], weight / total


def solve(world: World, reward: Array, *, temperature: float = 0.0, discount: float = DISCOUNT) -> Solution:
    """(Soft) value iteration with an infinite horizon: the stationary optimum for r [S, A] or [S, A, S'].

    Maximises the discounted sum of r + temperature * entropy of pi. Every sweep multiplies the error by the discount,
    so the number of sweeps is fixed in advance. ValueError for a discount outside [0, 1) or a negative temperature.
    """
    if not 0.0 <= discount < 1.0:
        raise ValueError(f"the discount is {discount}, wanted at least 0 and below 1: the horizon is infinite")
    _check_temperature(temperature)
    r = expected_reward(world, reward)
    v = np.zeros(len(world))
    for _ in range(math.ceil(math.log(TOLERANCE) / math.log(discount)) if discount else 1):
        v, _ = soft_backup(r + discount * expected_value(world, v), temperature)
    q = r + discount * expected_value(world, v)
    v, pi = soft_backup(q, temperature)
    return Solution(q=q, v=v, pi=pi)


def solve_horizon(
    world: World, reward: Array, *, temperature: float = 0.0, discount: float = 1.0, horizon: int = HORIZON
) -> Solution:
    """(Soft) value iteration over `horizon` steps, by backward induction; index t has horizon - t steps left."""
    _check_temperature(temperature)
    r = expected_reward(world, reward)
    q = np.zeros((horizon, *r.shape))
    v = np.zeros((horizon + 1, len(world)))
    pi = np.zeros_like(q)
    for t in reversed(range(horizon)):
        q[t] = r + discount * expected_value(world, v[t + 1])
        v[t], pi[t] = soft_backup(q[t], temperature)
    return Solution(q=q, v=v[:-1], pi=pi)


def random_policy(world: World) -> Array:
    """[S, A] the uniform random policy."""
    return np.full((len(world), len(ACTIONS)), 1.0 / len(ACTIONS))


def occupancy(world: World, pi: Array, horizon: int = HORIZON) -> Array:
    """[T, S] probability that an agent following pi [S, A] or [T, S, A] is in s when it takes action t."""
    steps = policy_per_step(world, pi, horizon)
    visits = np.zeros((horizon, len(world)))
    now = world.start
    for t in range(horizon):
        visits[t] = now
        now = next_distribution(world, now, steps[t])
    return visits


def next_distribution(world: World, now: Array, pi: Array) -> Array:
    """[S] the probability mass per state after one step of pi [S, A] from the probability mass `now` [S]."""
    acted = (1.0 - world.slip) * pi + world.slip / len(ACTIONS)
    mass = (now[:, None] * acted).ravel()
    return np.bincount(world.next_state.ravel(), weights=mass, minlength=len(world)).astype(np.float64)


def distance_to(world: World, target: NDArray[np.bool_]) -> Array:
    """[S] the number of steps to the nearest cell of `target` [S] without slips; inf where none is reachable."""
    distance = np.where(target, 0.0, np.inf)
    while (nearer := np.minimum(distance, distance[world.next_state].min(axis=1) + 1.0)).tolist() != distance.tolist():
        distance = nearer
    return distance


def expected_return(world: World, pi: Array, reward: Array, *, horizon: int = HORIZON, discount: float = 1.0) -> float:
    """The expected return of pi [S, A] or [T, S, A] from the start distribution, computed exactly."""
    steps = policy_per_step(world, pi, horizon)
    per_state = (steps * expected_reward(world, reward)).sum(axis=2)
    earned = (occupancy(world, pi, horizon) * per_state).sum(axis=1)
    return float(earned @ discount ** np.arange(horizon))


def return_bounds(world: World, reward: Array, *, horizon: int = HORIZON, discount: float = 1.0) -> tuple[float, float]:
    """The expected returns of the random policy and of the optimal one. ValueError where they are equal."""
    best = solve_horizon(world, reward, discount=discount, horizon=horizon).pi
    random, optimal = (
        expected_return(world, policy, reward, horizon=horizon, discount=discount)
        for policy in (random_policy(world), best)
    )
    if optimal - random <= TIE * float(np.abs(reward).max()):
        raise ValueError(f"the random policy is optimal (return {random:.6g}), wanted a reward that separates policies")
    return random, optimal


def normalized_return(
    world: World,
    pi: Array,
    reward: Array,
    *,
    horizon: int = HORIZON,
    discount: float = 1.0,
    bounds: tuple[float, float] | None = None,
) -> float:
    """(return - random) / (optimal - random): 1 for the optimal policy within the horizon, 0 for the random one.

    `bounds` are the `return_bounds` if they were computed before.
    """
    random, optimal = bounds or return_bounds(world, reward, horizon=horizon, discount=discount)
    return (expected_return(world, pi, reward, horizon=horizon, discount=discount) - random) / (optimal - random)


def sample_trajectories(
    world: World, pi: Array, starts: NDArray[np.int64], rng: np.random.Generator, horizon: int = HORIZON
) -> Trajectories:
    """One episode of pi [S, A] or [T, S, A] from each start state [N]."""
    cumulative = np.cumsum(policy_per_step(world, pi, horizon), axis=2)
    states = np.zeros((len(starts), horizon + 1), dtype=np.int64)
    actions = np.zeros((len(starts), horizon), dtype=np.int64)
    states[:, 0] = starts
    for t in range(horizon):
        # The last column is left out and counts as 1: rounding errors cannot select an action past the last one.
        below = cumulative[t, states[:, t], :-1] <= rng.random((len(starts), 1))
        actions[:, t] = below.sum(axis=1)
        states[:, t + 1] = step(world, states[:, t], actions[:, t], rng)
    return Trajectories(states=states, actions=actions)


def policy_per_step(world: World, pi: Array, horizon: int) -> Array:
    """[T, S, A] from pi [S, A] or [T, S, A]. ValueError for other shapes, or rows that are no distributions."""
    shape = (len(world), len(ACTIONS))
    if horizon < 1 or pi.shape not in (shape, (horizon, *shape)):
        raise ValueError(f"a policy for {horizon} steps has shape {pi.shape}, wanted {shape} or {(horizon, *shape)}")
    if (pi < 0).any() or not np.allclose(pi.sum(axis=-1), 1.0, atol=1e-5):
        raise ValueError("a policy has negative probabilities, or probabilities that do not add up to 1 in some state")
    return np.broadcast_to(pi, (horizon, *shape))


def _check_temperature(temperature: float) -> None:
    if temperature < 0.0:
        raise ValueError(f"the temperature is {temperature}, wanted at least 0")
