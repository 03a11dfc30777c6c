"""What is exactly so in LanguageGridCraft: optimal policies, their returns, and demonstrations drawn from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridcraft.world import ACTIONS, DISCOUNT, HORIZON, World, expected_value, step, transitions

Array = NDArray[np.float64]

TOLERANCE = 1e-12  # of the largest value: what value iteration may leave undone
TIE = 1e-9  # of the largest |Q|: actions nearer than this to the best are as good, and share its probability


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """The optimum for one reward: stationary, or with a leading axis of T where the time left matters."""

    q: Array  # [(T,) S, A]
    v: Array  # [(T,) S]
    pi: Array  # [(T,) S, A] probabilities


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Paths:
    """N episodes of T steps."""

    states: NDArray[np.int64]  # [N, T + 1] where each action was taken, and where the last one led
    actions: NDArray[np.int64]  # [N, T]


def expected_reward(world: World, reward: Array) -> Array:
    """[S, A] from r [S, A] or r [S, A, S'], the latter averaged over where the action leads."""
    shape = (len(world), len(ACTIONS))
    if reward.shape not in (shape, (*shape, len(world))):
        raise ValueError(f"a reward table has shape {reward.shape}, wanted {shape} or {(*shape, len(world))}")
    if not np.isfinite(reward).all():
        raise ValueError("a reward table holds values that are not finite")
    wide = reward.astype(np.float64)
    return wide if wide.ndim == 2 else np.einsum("sat,sat->sa", transitions(world), wide)


def soft_backup(q: Array, temperature: float) -> tuple[Array, Array]:
    """v [S] and pi [S, A] of Q [S, A]: T log sum exp(Q / T) and its softmax, or at 0 the best actions alike."""
    best = q.max(axis=1, keepdims=True)
    if temperature == 0.0:
        optimal = (q >= best - TIE * np.abs(q).max()).astype(np.float64)
        return best[:, 0], optimal / optimal.sum(axis=1, keepdims=True)
    weight = np.exp((q - best) / temperature)
    total = weight.sum(axis=1, keepdims=True)
    return (best + temperature * np.log(total))[:, 0], weight / total


def solve(world: World, reward: Array, *, temperature: float = 0.0, discount: float = DISCOUNT) -> Solution:
    """(Soft) value iteration without end: the stationary optimum of r [S, A] or [S, A, S'].

    Maximises the discounted sum of r plus, above temperature 0, temperature times the policy's entropy. Each
    sweep shrinks the error by the discount, so their number is known beforehand.
    """
    if not 0.0 <= discount < 1.0:
        raise ValueError(f"the discount is {discount}, wanted 0 up to but not 1: the sum has no end")
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
    """The same over `horizon` steps, backwards from the end; index t of the result has horizon - t steps to go."""
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
    """[S, A] every action alike."""
    return np.full((len(world), len(ACTIONS)), 1.0 / len(ACTIONS))


def occupancy(world: World, pi: Array, horizon: int = HORIZON) -> Array:
    """[T, S] probability that pi [S, A] or [T, S, A] stands in s when it takes its t-th action."""
    steps = per_step(world, pi, horizon)
    at = np.zeros((horizon, len(world)))
    now = world.start
    for t in range(horizon):
        at[t] = now
        now = flow(world, now, steps[t])
    return at


def flow(world: World, at: Array, pi: Array) -> Array:
    """[S] where the probability mass at [S] goes in one step of pi [S, A]."""
    acted = (1.0 - world.slip) * pi + world.slip / len(ACTIONS)
    mass = (at[:, None] * acted).ravel()
    return np.bincount(world.next_state.ravel(), weights=mass, minlength=len(world)).astype(np.float64)


def steps_to(world: World, target: NDArray[np.bool_]) -> Array:
    """[S] the fewest steps to one of the cells marked [S], were there no slips; inf where there is no way."""
    distance = np.where(target, 0.0, np.inf)
    while (nearer := np.minimum(distance, distance[world.next_state].min(axis=1) + 1.0)).tolist() != distance.tolist():
        distance = nearer
    return distance


def expected_return(world: World, pi: Array, reward: Array, *, horizon: int = HORIZON, discount: float = 1.0) -> float:
    """The mean return of pi [S, A] or [T, S, A] from the start distribution, without sampling."""
    steps = per_step(world, pi, horizon)
    per_state = (steps * expected_reward(world, reward)).sum(axis=2)
    earned = (occupancy(world, pi, horizon) * per_state).sum(axis=1)
    return float(earned @ discount ** np.arange(horizon))


def return_bounds(world: World, reward: Array, *, horizon: int = HORIZON, discount: float = 1.0) -> tuple[float, float]:
    """The return of chance, and the most that can be had within the horizon."""
    best = solve_horizon(world, reward, discount=discount, horizon=horizon).pi
    chance, optimal = (
        expected_return(world, policy, reward, horizon=horizon, discount=discount)
        for policy in (random_policy(world), best)
    )
    if optimal - chance <= TIE * float(np.abs(reward).max()):
        raise ValueError(f"chance earns {chance:.6g}, as much as anyone can, under this reward: wanted one to gain by")
    return chance, optimal


def normalized_return(
    world: World,
    pi: Array,
    reward: Array,
    *,
    horizon: int = HORIZON,
    discount: float = 1.0,
    known: tuple[float, float] | None = None,
) -> float:
    """(return - random) / (optimal - random): 1 for the best that can be done within the horizon, 0 for chance.

    `known` are the `bounds`, where they are.
    """
    chance, optimal = known or return_bounds(world, reward, horizon=horizon, discount=discount)
    return (expected_return(world, pi, reward, horizon=horizon, discount=discount) - chance) / (optimal - chance)


def draw_paths(
    world: World, pi: Array, starts: NDArray[np.int64], rng: np.random.Generator, horizon: int = HORIZON
) -> Paths:
    """One episode of pi [S, A] or [T, S, A] from each of the starts [N]."""
    cumulative = np.cumsum(per_step(world, pi, horizon), axis=2)
    states = np.zeros((len(starts), horizon + 1), dtype=np.int64)
    actions = np.zeros((len(starts), horizon), dtype=np.int64)
    states[:, 0] = starts
    for t in range(horizon):
        # The last column is taken as 1, whatever rounding made of it: no draw may fall beyond the last action.
        below = cumulative[t, states[:, t], :-1] <= rng.random((len(starts), 1))
        actions[:, t] = below.sum(axis=1)
        states[:, t + 1] = step(world, states[:, t], actions[:, t], rng)
    return Paths(states=states, actions=actions)


def per_step(world: World, pi: Array, horizon: int) -> Array:
    """[T, S, A] a policy at each step, stationary or not."""
    shape = (len(world), len(ACTIONS))
    if horizon < 1 or pi.shape not in (shape, (horizon, *shape)):
        raise ValueError(f"a policy for {horizon} steps has shape {pi.shape}, wanted {shape} or {(horizon, *shape)}")
    if (pi < 0).any() or not np.allclose(pi.sum(axis=-1), 1.0, atol=1e-5):
        raise ValueError("a policy's probabilities are negative or do not add up to 1 in every state")
    return np.broadcast_to(pi, (horizon, *shape))


def _check_temperature(temperature: float) -> None:
    if temperature < 0.0:
        raise ValueError(f"the temperature is {temperature}, wanted 0 or more")
