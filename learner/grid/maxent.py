"""Maximum-entropy inverse reinforcement learning with known dynamics, the baseline of Fu et al. (2019)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from gridcraft.planning import occupancy, solve
from gridcraft.world import ACTIONS, DISCOUNT, HORIZON, World
from learner.grid.nets import GridFeatures, GridRewardNet, one_hot
from learner.grid.steps import EXPERT_TEMPERATURE, Index, Steps

Table = NDArray[np.float64]


class MaxEnt:
    """A reward net that reads the sentence, trained by exact planning (From Language to Goals, Fu et al. 2019).

    Under each sentence the policy is the soft optimum for the net's reward at the expert's temperature. The gradient of
    the likelihood of the demonstrations is the difference of two discounted visit counts, those of the demonstrations
    and those of this policy (Ziebart et al. 2008). It plays no episodes, but it has to know the transitions and the
    temperature of the expert. GIIRL knows neither.
    """

    def __init__(self, world: World, features: GridFeatures, demonstrations: Steps, *, width: int) -> None:
        if features.absorbing:
            raise ValueError("maximum entropy has no absorbing state here: wanted grid.absorbing=false")
        self._world, self._features = world, features
        self.net = GridRewardNet(features.reward_width, width)
        self.optimiser = torch.optim.Adam(self.net.parameters())
        shape = (-1, HORIZON)
        states, actions, goals = (
            part.reshape(shape) for part in (demonstrations.state, demonstrations.action, demonstrations.goal)
        )
        self._shown = {
            goal: _Shown.of(states[goals[:, 0] == goal], actions[goals[:, 0] == goal], len(world))
            for goal in sorted(set(goals[:, 0].tolist()))
        }

    def update(self, learning_rate: float) -> dict[str, float]:
        """One gradient step on all sentences. Returns the mean distance of the two visit counts, in steps."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate
        loss, distance = torch.zeros(()), 0.0
        for goal, shown in self._shown.items():
            reward = self._table(goal)
            pi = solve(self._world, reward.detach().numpy().astype(np.float64), temperature=EXPERT_TEMPERATURE).pi
            visits = occupancy(replace(self._world, start=shown.start), pi)
            expected = (DISCOUNT ** np.arange(HORIZON) @ visits)[:, None] * pi
            difference = expected - shown.visits
            loss = loss + (torch.tensor(difference, dtype=torch.float32) * reward).sum() / len(self._shown)
            distance += float(np.abs(difference).sum()) / len(self._shown)
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return {"distance": distance}

    def _table(self, goal: int) -> Tensor:
        """[S, A] the reward of every state and action under one sentence."""
        states: Index = np.repeat(np.arange(len(self._world)), len(ACTIONS))
        actions = np.tile(np.arange(len(ACTIONS)), len(self._world))
        inputs = self._features.reward_inputs(states, np.full_like(states, goal))
        table: Tensor = self.net(inputs, one_hot(actions)).view(len(self._world), len(ACTIONS))
        return table


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """The demonstrations under one sentence: where they start, and their discounted visits."""

    start: Table  # [S] fraction of the demonstrations
    visits: Table  # [S, A] discounted

    @classmethod
    def of(cls, states: Index, actions: Index, count: int) -> _Shown:
        start = np.bincount(states[:, 0], minlength=count) / len(states)
        visits = np.zeros((count, len(ACTIONS)))
        weights = np.broadcast_to(DISCOUNT ** np.arange(HORIZON), states.shape) / len(states)
        np.add.at(visits, (states, actions), weights)
        return cls(start, visits)
