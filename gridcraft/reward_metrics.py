"""How good a learned reward is, beyond the score of the policy it came with: measures on tables, all exact."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridcraft.instructions import Pair
from gridcraft.layouts import colour_number
from gridcraft.planning import (
    expected_reward,
    flow,
    per_step,
    solve,
    steps_to,
)
from gridcraft.world import DISCOUNT, HORIZON, World

Array = NDArray[np.float64]

EQUAL = 1e-9  # of the largest: values nearer than this are the same, whatever the order of the sums that made them


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """How two tables go together, by rank and by value; nan where one of them is constant."""

    spearman: float
    pearson: float


def state_mean(reward: Array) -> Array:
    """[S] the mean of r [S, A] over the actions: what the heat maps of the thesis show (figure 4.3)."""
    mean: Array = reward.mean(axis=1)
    return mean


def reoptimise(world: World, learned: Array, discount: float = DISCOUNT) -> Array:
    """[S, A] the policy of greedy value iteration on a frozen reward, ties shared.

    A reward is worth what an agent that knows nothing else makes of it (the transfer of Fu, Luo and Levine 2018).
    """
    return solve(world, learned, discount=discount).pi


def pearson(x: Array, y: Array) -> float:
    """Pearson's product-moment correlation; nan where x or y is constant."""
    unit_x, unit_y = _standardised(x), _standardised(y)
    return math.nan if unit_x is None or unit_y is None else float(np.clip(unit_x @ unit_y, -1.0, 1.0))


def spearman(x: Array, y: Array) -> float:
    """Spearman's rank correlation: Pearson's of the ranks, equal values sharing theirs."""
    return pearson(ranks(x), ranks(y))


def ranks(x: Array) -> Array:
    """[N] from 1; equal values get the mean of their ranks, and equal is what differs by rounding alone."""
    flat = x.ravel()
    order = np.argsort(flat)
    apart = np.diff(flat[order]) > EQUAL * np.abs(flat).max(initial=0.0)
    group = np.concatenate([[0], np.cumsum(apart)])
    counts = np.bincount(group)
    rank: Array = np.empty(flat.size)
    rank[order] = (np.cumsum(counts) - (counts - 1) / 2.0)[group]
    return rank


def value_correlation(world: World, learned: Array, value: Array) -> Correlation:
    """State-mean learned reward against the optimal value V* [S] of the true one: is the reward shaped?

    The thesis's claim behind figure 4.3, as a number. The sparse reward itself does not reach 1, V* does.
    """
    score = state_mean(expected_reward(world, learned))
    return Correlation(spearman=spearman(score, value), pearson=pearson(score, value))


def canonical(reward: Array, discount: float = DISCOUNT) -> Array:
    """[S, A, S'] C(R)(s,a,s') = R + E[g R(s',A,S') - R(s,A,S') - g R(S,A,S')], with S, A and S' uniform.

    Section 4 of Gleave et al. 2021, Quantifying Differences in Reward Functions; the same for every
    potential shaping R + g phi(s') - phi(s). r [S, A] is read as the R that pays alike for every s'.
    """
    R = np.repeat(reward[:, :, None], len(reward), axis=2) if reward.ndim == 2 else reward
    R = R.astype(np.float64)
    mean = R.mean(axis=(1, 2))
    C: Array = R + discount * mean - mean[:, None, None] - discount * mean.mean()
    C[np.abs(C) <= EQUAL * np.abs(R).max()] = 0.0
    return C


def epic_distance(one: Array, other: Array, discount: float = DISCOUNT) -> float:
    """Equivalent-policy invariant comparison, sqrt((1 - rho) / 2): 0 the same up to shaping and scale, 1 opposite.

    Section 4 of Gleave et al. 2021, with rho over every (s, a, s') alike, possible or not; nan where one of
    them is nothing but shaping. Of two unit vectors it is half the distance, which loses no digits near 0.
    """
    x, y = _standardised(canonical(one, discount)), _standardised(canonical(other, discount))
    return math.nan if x is None or y is None else float(np.linalg.norm(x - y) / 2.0)


def auc(higher: Array, lower: Array) -> float:
    """P(X > Y) + P(X = Y) / 2 for X from `higher` and Y from `lower`: the area under the ROC curve.

    By the rank sum (Mann and Whitney 1947).
    """
    if higher.size == 0 or lower.size == 0:
        raise ValueError(f"an AUC got {higher.size} values against {lower.size}, wanted at least one of each")
    rank = ranks(np.concatenate([higher.ravel(), lower.ravel()]).astype(np.float64))
    return float((rank[: higher.size].sum() - higher.size * (higher.size + 1) / 2) / (higher.size * lower.size))


def avoid_rank(world: World, score: Array, pair: Pair) -> float:
    """The chance that a cell of the avoided colour scores lower than a neutral one [S]; equal counts half.

    1/2 says that "avoid" was not learned. Neutral is every cell that is neither goal nor avoided. The score is
    `state_mean` of a reward; cells without one are left out.
    """
    avoid, neutral = _avoided_and_neutral(world, score, pair)
    return auc(score[neutral], score[avoid])


def matched_avoid_rank(world: World, score: Array, pair: Pair) -> float:
    """The same among cells equally many steps from the goal, as a learned reward also rises towards the goal.

    The mean over the avoided cells that have neutral ones to be compared with; nan where none has.
    """
    avoid, neutral = _avoided_and_neutral(world, score, pair)
    distance = steps_to(world, world.colour == colour_number(pair.goal))
    far_alike = (distance[avoid][:, None] == distance[neutral]) & (
        world.layout[avoid][:, None] == world.layout[neutral]
    )
    margin = score[neutral] - score[avoid][:, None]
    wins = np.where(far_alike, (margin > 0) + 0.5 * (margin == 0), 0.0).sum(axis=1)
    rivals = far_alike.sum(axis=1)
    return float((wins[rivals > 0] / rivals[rivals > 0]).mean()) if rivals.any() else math.nan


def violation_rate(world: World, pi: Array, pair: Pair, horizon: int = HORIZON) -> float:
    """The share of episodes in which pi [S, A] or [T, S, A] ever acts on the avoided colour, exactly."""
    avoid = world.colour == colour_number(pair.avoid)
    now, entered = world.start.copy(), 0.0
    for policy in per_step(world, pi, horizon):
        entered += float(now[avoid].sum())
        now[avoid] = 0.0
        now = flow(world, now, policy)
    return entered


def _standardised(x: Array) -> Array | None:
    """x less its mean, as a vector of length 1; None where it is constant."""
    centred: Array = x.ravel() - x.mean()
    length = float(np.linalg.norm(centred))
    if length <= EQUAL * float(np.abs(x).max(initial=0.0)) * math.sqrt(x.size):
        return None
    return centred / length


def _avoided_and_neutral(world: World, score: Array, pair: Pair) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """[S] and [S] the cells of the avoided colour, and those of neither colour, that have a score."""
    goal, avoid = world.colour == colour_number(pair.goal), world.colour == colour_number(pair.avoid)
    known = np.isfinite(score)
    return avoid & known, ~(goal | avoid) & known
