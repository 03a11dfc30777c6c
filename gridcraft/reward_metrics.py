"""Exact metrics of a learned reward table, independent of the policy that was trained with it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridcraft.instructions import ColourPair
from gridcraft.layouts import colour_number
from gridcraft.planning import (
    distance_to,
    expected_reward,
    next_distribution,
    policy_per_step,
    solve,
)
from gridcraft.world import DISCOUNT, HORIZON, World

Array = NDArray[np.float64]

TIE = 1e-9  # values within this fraction of the largest one are equal: floating-point sums depend on their order


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """Correlation of two tables, by rank and by value; nan where one of them is constant."""

    spearman: float
    pearson: float


def state_mean(reward: Array) -> Array:
    """[S] the mean of r [S, A] over actions, as shown in the heat maps of Luo (2019), figure 4.3."""
    mean: Array = reward.mean(axis=1)
    return mean


def reoptimise(world: World, learned: Array, discount: float = DISCOUNT) -> Array:
    """[S, A] the policy of greedy value iteration on the frozen reward; optimal actions share the probability.

    This measures the reward by an agent trained on nothing else (reward transfer; Fu, Luo and Levine 2018).
    """
    return solve(world, learned, discount=discount).pi


def pearson(x: Array, y: Array) -> float:
    """Pearson's product-moment correlation of x and y, of one shape; nan where one is constant."""
    unit_x, unit_y = _standardised(x), _standardised(y)
    return math.nan if unit_x is None or unit_y is None else float(np.clip(unit_x @ unit_y, -1.0, 1.0))


def spearman(x: Array, y: Array) -> float:
    """Spearman's rank correlation: Pearson's correlation of the ranks, where equal values share a rank."""
    return pearson(ranks(x), ranks(y))


def ranks(x: Array) -> Array:
    """[N] ranks from 1; equal values get the mean of their ranks. Values are equal within TIE."""
    flat = x.ravel()
    order = np.argsort(flat)
    different = np.diff(flat[order]) > TIE * np.abs(flat).max(initial=0.0)
    group = np.concatenate([[0], np.cumsum(different)])
    counts = np.bincount(group)
    rank: Array = np.empty(flat.size)
    rank[order] = (np.cumsum(counts) - (counts - 1) / 2.0)[group]
    return rank


def value_correlation(world: World, learned: Array, value: Array) -> Correlation:
    """Correlation of the state-mean learned reward with the optimal value V* [S] of the true reward.

    It measures the claim of Luo (2019), figure 4.3, that the learned reward is shaped. V* itself scores 1, the sparse
    true reward less.
    """
    score = state_mean(expected_reward(world, learned))
    return Correlation(spearman=spearman(score, value), pearson=pearson(score, value))


def canonical(reward: Array, discount: float = DISCOUNT) -> Array:
    """[S, A, S'] C(R)(s,a,s') = R + E[g R(s',A,S') - R(s,A,S') - g R(S,A,S')], with S, A and S' uniform.

    Section 4 of Gleave et al. 2021, Quantifying Differences in Reward Functions; the same for every
    potential shaping R + g phi(s') - phi(s). r [S, A] counts as an R that does not depend on s'.
    """
    R = np.repeat(reward[:, :, None], len(reward), axis=2) if reward.ndim == 2 else reward
    R = R.astype(np.float64)
    mean = R.mean(axis=(1, 2))
    C: Array = R + discount * mean - mean[:, None, None] - discount * mean.mean()
    C[np.abs(C) <= TIE * np.abs(R).max()] = 0.0
    return C


def epic_distance(one: Array, other: Array, discount: float = DISCOUNT) -> float:
    """EPIC distance sqrt((1 - rho) / 2): 0 for rewards equal up to shaping and scale, 1 for opposite ones.

    Equivalent-policy invariant comparison (Gleave et al. 2021, section 4), with rho uniform over all (s, a, s'),
    possible or not; nan where a reward is pure shaping. For unit vectors it equals half their distance, which is
    computed here because it is accurate near 0.
    """
    x, y = _standardised(canonical(one, discount)), _standardised(canonical(other, discount))
    return math.nan if x is None or y is None else float(np.linalg.norm(x - y) / 2.0)


def auc(positive: Array, negative: Array) -> float:
    """P(X > Y) + P(X = Y) / 2 for X from `positive` and Y from `negative`: the area under the ROC curve.

    Computed from the rank sum (Mann and Whitney 1947). ValueError where either is empty.
    """
    if positive.size == 0 or negative.size == 0:
        raise ValueError(
            f"an AUC got {positive.size} positives, {negative.size} negatives, wanted at least one of each"
        )
    rank = ranks(np.concatenate([positive.ravel(), negative.ravel()]).astype(np.float64))
    wins = rank[: positive.size].sum() - positive.size * (positive.size + 1) / 2
    return float(wins / (positive.size * negative.size))


def avoid_rank(world: World, score: Array, pair: ColourPair) -> float:
    """The probability that an avoided cell has a lower score [S] than a neutral cell; ties count half.

    1/2 means that "avoid" was not learned. Neutral cells are neither goal nor avoided. The score is the
    `state_mean` of a reward; cells where it is nan are left out.
    """
    avoid, neutral = _avoided_and_neutral(world, score, pair)
    return auc(score[neutral], score[avoid])


def matched_avoid_rank(world: World, score: Array, pair: ColourPair) -> float:
    """`avoid_rank` among cells of one layout at equal distance from the goal: shaped rewards rise towards the goal.

    The mean over avoided cells that have such a neutral cell; nan where none has.
    """
    avoid, neutral = _avoided_and_neutral(world, score, pair)
    distance = distance_to(world, world.colour == colour_number(pair.goal))
    matched = (distance[avoid][:, None] == distance[neutral]) & (world.layout[avoid][:, None] == world.layout[neutral])
    margin = score[neutral] - score[avoid][:, None]
    wins = np.where(matched, (margin > 0) + 0.5 * (margin == 0), 0.0).sum(axis=1)
    matches = matched.sum(axis=1)
    return float((wins[matches > 0] / matches[matches > 0]).mean()) if matches.any() else math.nan


def violation_rate(world: World, pi: Array, pair: ColourPair, horizon: int = HORIZON) -> float:
    """The exact fraction of episodes in which pi [S, A] or [T, S, A] takes a step on the avoided colour."""
    avoid = world.colour == colour_number(pair.avoid)
    now, entered = world.start.copy(), 0.0
    for policy in policy_per_step(world, pi, horizon):
        entered += float(now[avoid].sum())
        now[avoid] = 0.0
        now = next_distribution(world, now, policy)
    return entered


def _standardised(x: Array) -> Array | None:
    """x minus its mean, as a vector of length 1; None where x is constant."""
    centred: Array = x.ravel() - x.mean()
    length = float(np.linalg.norm(centred))
    if length <= TIE * float(np.abs(x).max(initial=0.0)) * math.sqrt(x.size):
        return None
    return centred / length


def _avoided_and_neutral(world: World, score: Array, pair: ColourPair) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """[S], [S] masks of the avoided cells and of the neutral cells whose score is finite."""
    goal, avoid = world.colour == colour_number(pair.goal), world.colour == colour_number(pair.avoid)
    known = np.isfinite(score)
    return avoid & known, ~(goal | avoid) & known
