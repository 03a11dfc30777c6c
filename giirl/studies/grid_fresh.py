"""How fast a fresh policy learns on a frozen reward, to compare shaped rewards with sparse ones."""

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

OPTIMAL = 0.99  # normalised return that counts as optimal


def steps_to_optimal(
    config: Config,
    learner: GridLearner,
    world: World,
    rewards: Sequence[NDArray[np.float64]],
    *,
    max_iterations: int,
) -> int | None:
    """Environment steps until the mean return of a fresh soft Q-learner reaches OPTIMAL on frozen rewards.

    `rewards` has one table [S, A] for each pair. Only plain sentences are used: sentence i means pair i. None if
    `max_iterations` are not enough.
    """
    torch.manual_seed(config.seed)
    rng = np.random.default_rng([config.seed, 1])
    goals = learner.goals.tolist()
    random = random_steps(world, goals, config.grid.random_episodes, rng, None)
    frozen = torch.tensor(np.stack(rewards), dtype=torch.float32)

    def reward_fn(steps: Steps) -> torch.Tensor:
        reward: torch.Tensor = frozen[steps.goal, steps.state, steps.action]
        return reward

    policy = GridSoftQ(config, learner.features, learner.goals, random, rng, reward_fn)
    source = GridSource(world, learner.features, learner.goals, policy.net, rng)
    true = [true_reward(world, pair) for pair in learner.pairs]
    for _ in range(max_iterations):
        rollouts = source.take(config.rollout_batch)
        policy.update(rollouts, reward_fn(rollouts))
        returns = [
            normalized_return(world, policy_table(policy.net, learner.features, i), r) for i, r in enumerate(true)
        ]
        if np.mean(returns) >= OPTIMAL:
            return learner.random_env_steps + source.env_steps
    return None
