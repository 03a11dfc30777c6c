"""What a policy and a reward learned in LanguageGridCraft are worth, layout by layout and goal by goal, exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from giirl.config import Config
from giirl.gridcraft import World, build_world, true_reward
from giirl.gridcraft_instructions import Pair, plain_sentence
from giirl.gridcraft_layouts import Layout
from giirl.oracle import fraction, solve, visits
from giirl.reward_measures import (
    avoid_rank,
    entering_rate,
    epic_distance,
    matched_avoid_rank,
    paired_goal_sensitivity,
    reoptimise,
    state_mean,
    value_correlation,
)
from learner.grid_nets import Sight, policy_table, reward_table
from learner.gridworld import GridLearner


@dataclass(frozen=True, slots=True, kw_only=True)
class Measures:
    """One goal in one layout; returns as fractions of optimal above chance."""

    pair: Pair
    policy: float  # the policy that was learned, as it explores
    cloning: float  # chance's, where nothing was cloned
    reoptimised: float  # value iteration on the frozen reward
    spearman: float  # of the state-mean reward with the optimal value
    pearson: float
    epic: float
    avoid_rank: float  # the chance that an avoided cell scores below a neutral one
    matched_avoid_rank: float  # the same among cells equally far from the goal
    sensitivity: (
        float  # the share of the expert's steps that earn more than under the sentence with its colours swapped
    )
    entered: float  # share of episodes in which the re-optimised agent enters the avoided colour
    expert_entered: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tables:
    """What was learned, for one layout and one sentence."""

    policy: NDArray[np.float64]  # [S, A]
    cloning: NDArray[np.float64]  # [S, A]
    reward: NDArray[np.float64]  # [S, A]


def learned_tables(config: Config, learner: GridLearner, world: World, pair: Pair) -> Tables:
    """The nets asked about every state and action under the plain sentence of a pair, seen in training or not."""
    sight = Sight(world, [plain_sentence(pair)], learner.bag, config.grid)
    form, clip = config.discriminator.reward, config.discriminator.clip
    return Tables(
        policy=policy_table(learner.acting, sight, 0),
        cloning=policy_table(learner.cloner.net, sight, 0),
        reward=reward_table(learner.discriminator.net, sight, 0, form, clip),
    )


def policy_fractions(config: Config, learner: GridLearner, world: World) -> list[float]:
    """The policy's return under each pair of the training, as a fraction of optimal above chance."""
    sight = Sight(world, [plain_sentence(pair) for pair in learner.pairs], learner.bag, config.grid)
    return [
        fraction(world, policy_table(learner.acting, sight, i), true_reward(world, pair))
        for i, pair in enumerate(learner.pairs)
    ]


def measure(config: Config, learner: GridLearner, layouts: Sequence[Layout], pairs: Sequence[Pair]) -> list[Measures]:
    """Every layout with every pair, one at a time."""
    worlds = [build_world([layout]) for layout in layouts]
    return [_measure(config, learner, world, pair) for world in worlds for pair in pairs]


def _measure(config: Config, learner: GridLearner, world: World, pair: Pair) -> Measures:
    true, tables = true_reward(world, pair), learned_tables(config, learner, world, pair)
    agent, score = reoptimise(world, tables.reward), state_mean(tables.reward)
    expert = solve(world, true, temperature=config.grid.expert_temperature).pi
    correlation = value_correlation(world, tables.reward, true)
    swapped = learned_tables(config, learner, world, Pair(pair.avoid, pair.goal)).reward
    steps = visits(world, expert).sum(axis=0)[:, None] * expert
    return Measures(
        pair=pair,
        policy=fraction(world, tables.policy, true),
        cloning=fraction(world, tables.cloning, true),
        reoptimised=fraction(world, agent, true),
        spearman=correlation.spearman,
        pearson=correlation.pearson,
        epic=epic_distance(tables.reward, true),
        avoid_rank=avoid_rank(world, score, pair),
        matched_avoid_rank=matched_avoid_rank(world, score, pair),
        sensitivity=paired_goal_sensitivity(tables.reward, swapped, steps),
        entered=entering_rate(world, agent, pair),
        expert_entered=entering_rate(world, expert, pair),
    )


def means(measures: Sequence[Measures]) -> dict[str, float]:
    """The mean of each measure over layouts and goals; nan only where it is nan everywhere."""
    names = [field.name for field in fields(Measures) if field.name != "pair"]
    table = np.array([[getattr(one, name) for name in names] for one in measures])
    known = np.isfinite(table)
    mean = np.where(known, table, 0.0).sum(axis=0) / np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    return {name: float(value) for name, value in zip(names, mean, strict=True)}
