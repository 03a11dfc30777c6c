"""The networks for LanguageGridCraft (Luo 2019, figure 4.2) and their input features."""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from giirl_core.config import GridConfig
from giirl_core.nets.reward import reward_of
from gridcraft.instructions import rename_colours
from gridcraft.layouts import COLOURS, WALL, colour_number
from gridcraft.world import ACTIONS, World, observations
from learner.grid.goal_features import BagOfWords

STAY = ACTIONS.index("stay")


class GridFeatures:
    """Input features of the states and sentences of a world. State S, the last one, is the absorbing end state."""

    def __init__(self, world: World, sentences: Sequence[str], bag: BagOfWords, grid: GridConfig) -> None:
        self._world, self._sentences, self._bag, self._grid = world, sentences, bag, grid
        self.states = torch.tensor(self._states(world))  # [S + 1, F] inputs of the reward
        self.policy_states = self.states  # [S + 1, F'] inputs of the policy; it may also see the whole map
        if grid.full_map:
            self.policy_states = torch.cat([self.states, torch.tensor(np.pad(_maps(world), ((0, 1), (0, 0))))], dim=1)
        self.goals = self._goals(sentences)  # [G, V]
        self.end_state = len(world)
        self.absorbing = grid.absorbing

    @property
    def reward_width(self) -> int:
        """F + V, the input width of the reward."""
        return self.states.shape[1] + self.goals.shape[1]

    @property
    def policy_width(self) -> int:
        """F' + V, the input width of the policy."""
        return self.policy_states.shape[1] + self.goals.shape[1]

    def policy_inputs(self, state: NDArray[np.int64], goal: NDArray[np.int64]) -> Tensor:
        """[N, F' + V] policy inputs for N states and N sentences."""
        return torch.cat([self.policy_states[torch.from_numpy(state)], self.goals[torch.from_numpy(goal)]], dim=1)

    def reward_inputs(self, state: NDArray[np.int64], goal: NDArray[np.int64]) -> Tensor:
        """[N, F + V] reward inputs for N states and N sentences."""
        return torch.cat([self.states[torch.from_numpy(state)], self.goals[torch.from_numpy(goal)]], dim=1)

    @functools.cached_property
    def colour_permutations(self) -> tuple[Tensor, Tensor]:
        """[P, S + 1, F] states and [P, G, V] sentences under every permutation of the colours, applied to both."""
        states, goals = [], []
        for permuted in itertools.permutations(self._grid.colours):
            names = dict(zip(self._grid.colours, permuted, strict=True))
            number = np.array([0, *(colour_number(names.get(colour, colour)) for colour in COLOURS)])
            states.append(self._states(dataclasses.replace(self._world, colour=number[self._world.colour])))
            goals.append(self._goals([rename_colours(sentence, names) for sentence in self._sentences]))
        return torch.tensor(np.stack(states)), torch.stack(goals)

    def _states(self, world: World) -> NDArray[np.float32]:
        features = np.pad(observations(world, self._grid.adjacent_cells), ((0, 1), (0, int(self._grid.absorbing))))
        if self._grid.absorbing:
            features[-1, -1] = 1.0  # marks the end state
        return features

    def _goals(self, sentences: Sequence[str]) -> Tensor:
        return torch.tensor(np.stack([self._bag(sentence) for sentence in sentences]))


def _maps(world: World) -> NDArray[np.float32]:
    """[S, H * W * 5 + H + W] one-hot cells (wall or colour) of each state's layout, then its row and column one-hot."""
    shapes = {layout.cells.shape for layout in world.layouts}
    if len(shapes) > 1:
        raise ValueError(f"grid.full_map got layouts of shapes {sorted(shapes)}, wanted one shape for all")
    cells = np.stack([layout.cells for layout in world.layouts])
    planes = cells[..., None] == np.array([WALL, *range(1, len(COLOURS) + 1)])
    maps = planes.reshape(len(cells), -1)[world.layout]
    height, width = cells.shape[1:]
    row, column = np.eye(height)[world.position[:, 0]], np.eye(width)[world.position[:, 1]]
    features: NDArray[np.float32] = np.concatenate([maps, row, column], axis=1).astype(np.float32)
    return features


class GridRewardNet(nn.Module):
    """The discriminator: MLP(goal, observation) and MLP(action), concatenated -> MLP -> logit log D - log(1 - D)."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.place = nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.action = nn.Sequential(nn.Linear(len(ACTIONS), width // 2), nn.ReLU())
        self.judge = nn.Sequential(nn.Linear(width + width // 2, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, inputs: Tensor, action: Tensor) -> Tensor:
        """[N] logits from reward inputs [N, F + V] and one-hot actions [N, A]."""
        logit: Tensor = self.judge(torch.cat([self.place(inputs), self.action(action)], dim=1)).squeeze(1)
        return logit


class PotentialNet(nn.Module):
    """The shaping potential h(s | g) of AIRL (Fu, Luo and Levine 2018)."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, inputs: Tensor) -> Tensor:
        """[N] potentials from reward inputs [N, F + V]."""
        potential: Tensor = self.net(inputs).squeeze(1)
        return potential


class QNet(nn.Module):
    """Q(s, . | g) and its softmax policy at temperature alpha. Outputs are Q / `scale`, which keeps them near 1."""

    def __init__(self, inputs: int, width: int, alpha: float, scale: float) -> None:
        super().__init__()
        self.alpha, self.scale = alpha, scale
        self.net = nn.Sequential(
            nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, len(ACTIONS))
        )

    def forward(self, inputs: Tensor) -> Tensor:
        """[N, A] Q / `scale` from policy inputs [N, F' + V]."""
        q: Tensor = self.net(inputs)
        return q

    def log_policy(self, inputs: Tensor) -> Tensor:
        """[N, A] log pi(a | s, g) from policy inputs [N, F' + V]."""
        return functional.log_softmax(self(inputs) * (self.scale / self.alpha), dim=1)


def one_hot(action: NDArray[np.int64]) -> Tensor:
    """[N, A] one-hot encoding of actions [N]."""
    return functional.one_hot(torch.from_numpy(action), len(ACTIONS)).float()


@torch.no_grad()
def reward_table(net: GridRewardNet, features: GridFeatures, goal: int, form: str, clip: float) -> NDArray[np.float64]:
    """[S, A] the reward of every state and action under the sentence `goal`."""
    states = np.arange(features.end_state)
    inputs = features.reward_inputs(states, np.full(features.end_state, goal))
    columns = [net(inputs, one_hot(np.full(features.end_state, a))) for a in range(len(ACTIONS))]
    table: NDArray[np.float64] = reward_of(torch.stack(columns, dim=1), form, clip).numpy().astype(np.float64)
    return table


@torch.no_grad()
def policy_table(net: QNet, features: GridFeatures, goal: int) -> NDArray[np.float64]:
    """[S, A] pi(a | s, g) of every state and action under the sentence `goal`."""
    inputs = features.policy_inputs(np.arange(features.end_state), np.full(features.end_state, goal))
    logp = net.log_policy(inputs).double()
    table: NDArray[np.float64] = torch.softmax(logp, dim=1).numpy()  # float64, so that rows add up to 1
    return table
