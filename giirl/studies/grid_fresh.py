"""What a frozen reward is worth to a policy that starts from nothing: shaped against sparse."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from giirl_core.config import Config
from gridcraft.planning import normalized_return
from gridcraft.world import World, true_reward
from learner.grid.learner import GridLearner, GridSoftQ
from learner.grid.nets import policy_table
from learner.grid.steps import GridSource, Steps, random_steps

OPTIMAL = 0.99


def steps_to_optimal(
    config: Config,
    learner: GridLearner,
    world: World,
    rewards: Sequence[NDArray[np.float64]],
    *,
    most_iterations: int,
) -> int | None:
    """Environment steps until a fresh soft Q-learner's mean return reaches OPTIMAL on rewards frozen at [S, A] a pair.

    None where it does not within `most_iterations`. Plain sentences only: sentence i says pair i.
    """
    torch.manual_seed(config.seed)
    rng = np.random.default_rng([config.seed, 1])
    goals = learner.goals.tolist()
    chance = random_steps(world, goals, config.grid.random_episodes, rng, None)
    policy = GridSoftQ(config, learner.features, learner.goals, chance, rng)
    source = GridSource(world, learner.features, learner.goals, policy.net, rng)
    frozen = torch.tensor(np.stack(rewards), dtype=torch.float32)
    true = [true_reward(world, pair) for pair in learner.pairs]

    def reward_fn(steps: Steps) -> torch.Tensor:
        asked: torch.Tensor = frozen[steps.goal, steps.state, steps.action]
        return asked

    for _ in range(most_iterations):
        rollouts = source.take(config.rollout_batch)
        policy.update(rollouts, reward_fn(rollouts), reward_fn)
        got = [normalized_return(world, policy_table(policy.net, learner.features, i), r) for i, r in enumerate(true)]
        if np.mean(got) >= OPTIMAL:
            return learner.random_env_steps + source.env_steps
    return None
