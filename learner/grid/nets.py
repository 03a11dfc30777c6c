"""The nets of the thesis's tabular chapter (figure 4.2), and what they see of LanguageGridCraft."""

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
from gridcraft.instructions import rename
from gridcraft.layouts import COLOURS, WALL, colour_number
from gridcraft.world import ACTIONS, World, observations
from learner.grid.goal_features import BagOfWords

STAY = ACTIONS.index("stay")


class GridFeatures:
    """States and sentences of a world as the nets get them. State S, the last, is where absorbing episodes end."""

    def __init__(self, world: World, sentences: Sequence[str], bag: BagOfWords, grid: GridConfig) -> None:
        self._world, self._sentences, self._bag, self._grid = world, sentences, bag, grid
        self.states = torch.tensor(self._states(world))  # [S + 1, F]
        self.far = self.states  # [S + 1, F'] what a policy sees: it must also know where things are
        if grid.full_map:
            self.far = torch.cat([self.states, torch.tensor(np.pad(_maps(world), ((0, 1), (0, 0))))], dim=1)
        self.goals = self._goals(sentences)  # [G, V]
        self.end = len(world)
        self.absorbing = grid.absorbing

    @property
    def width(self) -> int:
        """F + V."""
        return self.states.shape[1] + self.goals.shape[1]

    @property
    def far_width(self) -> int:
        """F' + V."""
        return self.far.shape[1] + self.goals.shape[1]

    def wide(self, state: NDArray[np.int64], goal: NDArray[np.int64]) -> Tensor:
        """[N, F' + V] what a policy reads of N states under N sentences."""
        return torch.cat([self.far[torch.from_numpy(state)], self.goals[torch.from_numpy(goal)]], dim=1)

    def __call__(self, state: NDArray[np.int64], goal: NDArray[np.int64]) -> Tensor:
        """[N, F + V] what the reward reads of N states under N sentences."""
        return torch.cat([self.states[torch.from_numpy(state)], self.goals[torch.from_numpy(goal)]], dim=1)

    @functools.cached_property
    def renamings(self) -> tuple[Tensor, Tensor]:
        """[P, S + 1, F] states and [P, G, V] sentences under every way to swap the colours' names in both alike."""
        states, goals = [], []
        for others in itertools.permutations(self._grid.colours):
            names = dict(zip(self._grid.colours, others, strict=True))
            number = np.array([0, *(colour_number(names.get(colour, colour)) for colour in COLOURS)])
            states.append(self._states(dataclasses.replace(self._world, colour=number[self._world.colour])))
            goals.append(self._goals([rename(sentence, names) for sentence in self._sentences]))
        return torch.tensor(np.stack(states)), torch.stack(goals)

    def _states(self, world: World) -> NDArray[np.float32]:
        seen = np.pad(observations(world, self._grid.neighbours), ((0, 1), (0, int(self._grid.absorbing))))
        if self._grid.absorbing:
            seen[-1, -1] = 1.0
        return seen

    def _goals(self, sentences: Sequence[str]) -> Tensor:
        return torch.tensor(np.stack([self._bag(sentence) for sentence in sentences]))


def _maps(world: World) -> NDArray[np.float32]:
    """[S, H * W * 5 + H + W] the layout of each state, cell by cell as a colour or a wall, then its row and column."""
    shapes = {layout.cells.shape for layout in world.layouts}
    if len(shapes) > 1:
        raise ValueError(f"grid.full_map got layouts of the sizes {sorted(shapes)}, wanted one size for all")
    cells = np.stack([layout.cells for layout in world.layouts])
    planes = cells[..., None] == np.array([WALL, *range(1, len(COLOURS) + 1)])
    maps = planes.reshape(len(cells), -1)[world.layout]
    height, width = cells.shape[1:]
    row, column = np.eye(height)[world.position[:, 0]], np.eye(width)[world.position[:, 1]]
    seen: NDArray[np.float32] = np.concatenate([maps, row, column], axis=1).astype(np.float32)
    return seen


class RewardNet(nn.Module):
    """Goal features and observation -> MLP, action -> MLP, joined -> MLP -> logit."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.place = nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU())
        self.action = nn.Sequential(nn.Linear(len(ACTIONS), width // 2), nn.ReLU())
        self.judge = nn.Sequential(nn.Linear(width + width // 2, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, seen: Tensor, action: Tensor) -> Tensor:
        """[N] logits from [N, F + V] and one-hot actions [N, A]."""
        judged: Tensor = self.judge(torch.cat([self.place(seen), self.action(action)], dim=1)).squeeze(1)
        return judged


class PotentialNet(nn.Module):
    """h(s | g) of the AIRL form, which takes the shaping so that the reward need not."""

    def __init__(self, inputs: int, width: int) -> None:
        super().__init__()
        self.net = nn.Sequential(nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, 1))

    def forward(self, seen: Tensor) -> Tensor:
        """[N] from [N, F + V]."""
        potential: Tensor = self.net(seen).squeeze(1)
        return potential


class QNet(nn.Module):
    """Q(s, . | g), and the policy softmax(Q / alpha) that follows from it. `scale` keeps what it outputs near 1."""

    def __init__(self, inputs: int, width: int, alpha: float, scale: float) -> None:
        super().__init__()
        self.alpha, self.scale = alpha, scale
        self.net = nn.Sequential(
            nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, len(ACTIONS))
        )

    def forward(self, seen: Tensor) -> Tensor:
        """[N, A] in units of `scale`."""
        q: Tensor = self.net(seen)
        return q

    def log_policy(self, seen: Tensor) -> Tensor:
        """[N, A] log pi(a | s, g)."""
        return functional.log_softmax(self(seen) * (self.scale / self.alpha), dim=1)


def one_hot(action: NDArray[np.int64]) -> Tensor:
    """[N, A]."""
    return functional.one_hot(torch.from_numpy(action), len(ACTIONS)).float()


@torch.no_grad()
def reward_table(net: RewardNet, sight: GridFeatures, goal: int, form: str, clip: float) -> NDArray[np.float64]:
    """[S, A] the reward of every state and action under one sentence."""
    states = np.arange(sight.end)
    seen = sight(states, np.full(sight.end, goal))
    columns = [net(seen, one_hot(np.full(sight.end, a))) for a in range(len(ACTIONS))]
    table: NDArray[np.float64] = reward_of(torch.stack(columns, dim=1), form, clip).numpy().astype(np.float64)
    return table


@torch.no_grad()
def policy_table(net: QNet, sight: GridFeatures, goal: int) -> NDArray[np.float64]:
    """[S, A] the probabilities of every action in every state under one sentence."""
    logp = net.log_policy(sight.wide(np.arange(sight.end), np.full(sight.end, goal))).double()
    table: NDArray[np.float64] = torch.softmax(logp, dim=1).numpy()  # in doubles, so that rows add up to 1
    return table
