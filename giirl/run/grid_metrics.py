"""Exact measures of a policy and a reward learned in LanguageGridCraft, for each layout and goal."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from giirl.statistics import goal_sensitivity
from giirl_core.config import Config
from gridcraft.instructions import ColourPair, plain_sentence
from gridcraft.layouts import Layout
from gridcraft.planning import normalized_return, occupancy, return_bounds, solve
from gridcraft.reward_metrics import (
    avoid_rank,
    epic_distance,
    matched_avoid_rank,
    reoptimise,
    state_mean,
    value_correlation,
    violation_rate,
)
from gridcraft.world import World, build_world, true_reward
from learner.grid.learner import GridLearner
from learner.grid.nets import GridFeatures, policy_table, reward_table
from learner.grid.steps import EXPERT_TEMPERATURE


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """Measures of one goal in one layout. Returns are normalised: 0 is the random policy, 1 the optimal one."""

    pair: ColourPair
    policy: float  # return of the learned policy, as it explores
    cloning: float  # return of the cloned policy; 0 if nothing was cloned
    reoptimised: float  # return of value iteration on the frozen reward
    spearman: float  # correlation of the state-mean reward with the optimal value
    pearson: float
    epic: float
    avoid_rank: float  # probability that an avoided cell has a lower reward than a neutral one
    matched_avoid_rank: float  # the same among cells at the same distance from the goal
    sensitivity: float  # fraction of expert steps with a higher reward than under the sentence with swapped colours
    entered: float  # fraction of episodes in which the re-optimised policy enters the avoided colour
    expert_entered: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tables:
    """The learned nets as tables, for one layout and one sentence."""

    policy: NDArray[np.float64]  # [S, A]
    cloning: NDArray[np.float64]  # [S, A]
    reward: NDArray[np.float64]  # [S, A]


def learned_tables(config: Config, learner: GridLearner, world: World, pair: ColourPair) -> Tables:
    """The nets evaluated on every state and action under the plain sentence of a pair, trained on or not."""
    features = GridFeatures(world, [plain_sentence(pair)], learner.bag, config.grid)
    form, clip = config.discriminator.reward, config.discriminator.clip
    return Tables(
        policy=policy_table(learner.behaviour_policy, features, 0),
        cloning=policy_table(learner.cloner.net, features, 0),
        reward=reward_table(learner.discriminator.net, features, 0, form, clip),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundTruth:
    """Properties of a world under a pair, independent of what was learned."""

    reward: NDArray[np.float64]  # [S, A]
    value: NDArray[np.float64]  # [S] V*
    bounds: tuple[float, float]  # returns of the random and of the optimal policy
    expert: NDArray[np.float64]  # [S, A] the policy that demonstrates


@functools.lru_cache(maxsize=1024)
def ground_truth(world: World, pair: ColourPair) -> GroundTruth:
    """Computed once for each world and pair."""
    reward = true_reward(world, pair)
    return GroundTruth(
        reward=reward,
        value=solve(world, reward).v,
        bounds=return_bounds(world, reward),
        expert=solve(world, reward, temperature=EXPERT_TEMPERATURE).pi,
    )


@functools.lru_cache(maxsize=256)
def layout_world(layout: Layout) -> World:
    """A world of this layout alone; the same object for the same layout."""
    return build_world([layout])


def policy_returns(config: Config, learner: GridLearner, world: World) -> list[float]:
    """The normalised return of the policy under each training pair."""
    features = GridFeatures(world, [plain_sentence(pair) for pair in learner.pairs], learner.bag, config.grid)
    known = [ground_truth(world, pair) for pair in learner.pairs]
    return [
        normalized_return(world, policy_table(learner.behaviour_policy, features, i), true.reward, bounds=true.bounds)
        for i, true in enumerate(known)
    ]


def measure(
    config: Config, learner: GridLearner, layouts: Sequence[Layout], pairs: Sequence[ColourPair]
) -> list[Measures]:
    """Measure every pair in every layout."""
    return [_measure(config, learner, layout_world(layout), pair) for layout in layouts for pair in pairs]


def _measure(config: Config, learner: GridLearner, world: World, pair: ColourPair) -> Measures:
    true, tables = ground_truth(world, pair), learned_tables(config, learner, world, pair)
    swapped = learned_tables(config, learner, world, ColourPair(pair.avoid, pair.goal)).reward
    agent, score = reoptimise(world, tables.reward), state_mean(tables.reward)
    policy, cloning, reoptimised = (
        normalized_return(world, pi, true.reward, bounds=true.bounds) for pi in (tables.policy, tables.cloning, agent)
    )
    correlation = value_correlation(world, tables.reward, true.value)
    steps = occupancy(world, true.expert).sum(axis=0)[:, None] * true.expert
    return Measures(
        pair=pair,
        policy=policy,
        cloning=cloning,
        reoptimised=reoptimised,
        spearman=correlation.spearman,
        pearson=correlation.pearson,
        epic=epic_distance(tables.reward, true.reward),
        avoid_rank=avoid_rank(world, score, pair),
        matched_avoid_rank=matched_avoid_rank(world, score, pair),
        sensitivity=goal_sensitivity(tables.reward, swapped, steps),
        entered=violation_rate(world, agent, pair),
        expert_entered=violation_rate(world, true.expert, pair),
    )


def means(measures: Sequence[Measures]) -> dict[str, float]:
    """The mean of each measure over layouts and goals without nan; nan only if all are nan."""
    names = [field.name for field in fields(Measures) if field.name != "pair"]
    table = np.array([[getattr(one, name) for name in names] for one in measures])
    known = np.isfinite(table)
    mean = np.where(known, table, 0.0).sum(axis=0) / np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return {name: float(value) for name, value in zip(names, mean, strict=True)}
