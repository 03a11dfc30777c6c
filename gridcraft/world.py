"""LanguageGridCraft (Luo 2019, section 4.1) as tables, small enough to solve exactly.

A world is one or more disconnected layouts. Its states are the cells of all layouts that are no walls, numbered
consecutively, so one transition table moves agents in every layout at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridcraft.instructions import ColourPair
from gridcraft.layouts import COLOURS, WALL, WHITE, Layout, colour_number

ACTIONS = ("up", "down", "left", "right", "stay")
MOVES = ((-1, 0), (1, 0), (0, -1), (0, 1), (0, 0))  # rows down, columns right
HORIZON = 30  # steps per episode; episodes end in no other way
DISCOUNT = 0.95


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """S states and A = 5 actions; a move into a wall or off the map leaves the agent in place. Tables are read-only."""

    layouts: tuple[Layout, ...]
    layout: NDArray[np.int64]  # [S] index into `layouts`
    position: NDArray[np.int64]  # [S, 2] row and column in that layout
    colour: NDArray[np.int64]  # [S] 0 white, i + 1 COLOURS[i]
    next_state: NDArray[np.int64]  # [S, A] next state when the action does not slip
    start: NDArray[np.float64]  # [S] probability: uniform over layouts, then over the white cells of the layout
    slip: float  # probability that a uniformly random action is executed instead

    def __len__(self) -> int:
        return len(self.colour)


def build_world(layouts: Sequence[Layout], slip: float = 0.0) -> World:
    """The tables of these layouts, in order. ValueError without a layout, or with a slip outside [0, 1]."""
    if not layouts:
        raise ValueError("a world needs at least one layout, got none")
    if not 0.0 <= slip <= 1.0:
        raise ValueError(f"slip is {slip}, wanted a probability from 0 to 1")
    next_states, positions, owners, first = [], [], [], 0
    for number, layout in enumerate(layouts):
        walled = np.pad(layout.cells, 1, constant_values=WALL)
        state = np.full(walled.shape, -1)
        position = np.argwhere(walled != WALL)
        state[tuple(position.T)] = first + np.arange(len(position))
        target = state[tuple(np.moveaxis(position[:, None] + np.array(MOVES), -1, 0))]
        next_states.append(np.where(target < 0, state[tuple(position.T)][:, None], target))
        positions.append(position - 1)
        owners.append(np.full(len(position), number))
        first += len(position)
    colour = np.concatenate([layout.cells[layout.cells != WALL] for layout in layouts]).astype(np.int64)
    owner = np.concatenate(owners)
    white = np.where(colour == WHITE, 1.0, 0.0)
    start = white / np.bincount(owner, weights=white)[owner] / len(layouts)
    world = World(
        layouts=tuple(layouts),
        layout=owner,
        position=np.concatenate(positions),
        colour=colour,
        next_state=np.concatenate(next_states),
        start=start,
        slip=slip,
    )
    for table in (world.layout, world.position, world.colour, world.next_state, world.start):
        table.setflags(write=False)
    return world


def step_reward(colour: NDArray[np.int64], goal: NDArray[np.int64], avoid: NDArray[np.int64]) -> NDArray[np.float64]:
    """The true reward of a step taken on a cell of this colour: +1 on the goal, -1 on the avoided colour, else 0.

    All arguments are colour numbers, of any shapes that broadcast.
    """
    reward: NDArray[np.float64] = np.subtract(colour == goal, colour == avoid, dtype=np.float64)
    return reward


def true_reward(world: World, pair: ColourPair) -> NDArray[np.float64]:
    """[S, A] the sparse reward of the thesis. It depends on the cell the agent acts from, not on the action.

    ValueError where a layout lacks one of the two colours.
    """
    for layout in world.layouts:
        if lacking := {pair.goal, pair.avoid} - set(layout.colours):
            raise ValueError(f"layout {layout.name!r} has no {min(lacking)} cell, wanted both colours of {pair}")
    reward = step_reward(world.colour, np.array(colour_number(pair.goal)), np.array(colour_number(pair.avoid)))
    return np.repeat(reward[:, None], len(ACTIONS), axis=1)


def expected_value(world: World, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """[S, A] the expectation of value [S] in the next state, including slips."""
    intended = value[world.next_state]
    mean: NDArray[np.float64] = (1.0 - world.slip) * intended + world.slip * intended.mean(axis=1, keepdims=True)
    return mean


def transitions(world: World) -> NDArray[np.float64]:
    """[S, A, S] transition probabilities. `expected_value` and `step` avoid building this table."""
    intended = np.eye(len(world))[world.next_state]
    table: NDArray[np.float64] = (1.0 - world.slip) * intended + world.slip * intended.mean(axis=1, keepdims=True)
    return table


def sample_starts(world: World, agents: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """[N] start states, all on white cells."""
    return rng.choice(len(world), size=agents, p=world.start)


def step(
    world: World, state: NDArray[np.int64], action: NDArray[np.int64], rng: np.random.Generator
) -> NDArray[np.int64]:
    """[N] the states of N agents after one action each; `rng` is used only if the world has slips."""
    if world.slip > 0.0:
        slips = rng.random(state.shape) < world.slip
        action = np.where(slips, rng.integers(len(ACTIONS), size=state.shape), action)
    return world.next_state[state, action]


def observations(world: World, adjacent_cells: bool = True) -> NDArray[np.float32]:
    """[S, F] the observation in each state, without information about which layout it is in.

    Row and column scaled to [-1, 1] and the cell's colour as one-hot of 5: F = 7. With `adjacent_cells` also each of
    the four cells around it as one-hot of 6 (white, the colours, wall or edge): F = 31.
    """
    size = np.array([layout.cells.shape for layout in world.layouts])[world.layout]
    scaled = 2.0 * world.position / np.maximum(size - 1, 1) - 1.0
    kinds = len(COLOURS) + 1
    features = [scaled, np.eye(kinds)[world.colour]]
    if adjacent_cells:
        blocked = world.next_state[:, :4] == np.arange(len(world))[:, None]
        adjacent = np.where(blocked, kinds, world.colour[world.next_state[:, :4]])
        features.append(np.eye(kinds + 1)[adjacent].reshape(len(world), -1))
    return np.concatenate(features, axis=1).astype(np.float32)
