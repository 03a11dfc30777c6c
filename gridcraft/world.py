"""LanguageGridCraft (thesis, section 4.1) as tables: small enough that everything about it can be computed exactly.

A world is one layout or many side by side. Its states are the open cells of all of them, numbered through, so
that one table moves agents in every layout at once and nobody can stand in a wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridcraft.instructions import Pair
from gridcraft.layouts import COLOURS, WALL, WHITE, Layout, colour_number

ACTIONS = ("up", "down", "left", "right", "stay")
MOVES = ((-1, 0), (1, 0), (0, -1), (0, 1), (0, 0))  # rows down, columns right
HORIZON = 30  # steps of an episode; nothing else ends it
DISCOUNT = 0.95


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """S states and A = 5 actions; a step into a wall or over the edge stays where it is."""

    layouts: tuple[Layout, ...]
    layout: NDArray[np.int64]  # [S] which of the layouts
    position: NDArray[np.int64]  # [S, 2] row and column there
    colour: NDArray[np.int64]  # [S] 0 white, i + 1 COLOURS[i]
    next_state: NDArray[np.int64]  # [S, A] where an action leads when it does not slip
    start: NDArray[np.float64]  # [S] probability: layouts alike, and in each its white cells alike
    slip: float  # probability that one of the five actions, drawn at random, happens instead

    def __len__(self) -> int:
        return len(self.colour)


def build_world(layouts: Sequence[Layout], slip: float = 0.0) -> World:
    """The tables of these layouts, in their order."""
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
    """The true reward of a step by the colour it is taken on: +1 on the goal, -1 on the avoided, else 0.

    Numbers of colours, any shapes that broadcast.
    """
    pay: NDArray[np.float64] = np.subtract(colour == goal, colour == avoid, dtype=np.float64)
    return pay


def true_reward(world: World, pair: Pair) -> NDArray[np.float64]:
    """[S, A] the sparse reward of the thesis; it depends on the cell the agent stands on when it acts, not on a."""
    for layout in world.layouts:
        if lacking := {pair.goal, pair.avoid} - set(layout.colours):
            raise ValueError(f"layout {layout.name!r} has no {min(lacking)} cell, which {pair} speaks of")
    reward = step_reward(world.colour, np.array(colour_number(pair.goal)), np.array(colour_number(pair.avoid)))
    return np.repeat(reward[:, None], len(ACTIONS), axis=1)


def expected_value(world: World, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """[S, A] the mean of value [S] over where an action leads, slips included."""
    led = value[world.next_state]
    mean: NDArray[np.float64] = (1.0 - world.slip) * led + world.slip * led.mean(axis=1, keepdims=True)
    return mean


def transitions(world: World) -> NDArray[np.float64]:
    """[S, A, S] probability of each next state. `expect` and `step` do not need this table."""
    led = np.eye(len(world))[world.next_state]
    table: NDArray[np.float64] = (1.0 - world.slip) * led + world.slip * led.mean(axis=1, keepdims=True)
    return table


def draw_starts(world: World, agents: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """[N] white cells to start on."""
    return rng.choice(len(world), size=agents, p=world.start)


def step(
    world: World, state: NDArray[np.int64], action: NDArray[np.int64], rng: np.random.Generator
) -> NDArray[np.int64]:
    """[N] where N agents stand after one action each; draws from `rng` only in a world that slips."""
    if world.slip > 0.0:
        slips = rng.random(state.shape) < world.slip
        action = np.where(slips, rng.integers(len(ACTIONS), size=state.shape), action)
    return world.next_state[state, action]


def observations(world: World, neighbours: bool = True) -> NDArray[np.float32]:
    """[S, F] what an agent sees in each state, the same numbers for the same sight in every layout.

    Row and column from -1 to 1, its cell's colour as one of 5, and with `neighbours` each of the four cells
    around as one of 6 (white, the colours, wall or edge): F = 7 or 31.
    """
    size = np.array([layout.cells.shape for layout in world.layouts])[world.layout]
    place = 2.0 * world.position / np.maximum(size - 1, 1) - 1.0
    kinds = len(COLOURS) + 1
    seen = [place, np.eye(kinds)[world.colour]]
    if neighbours:
        stays = world.next_state[:, :4] == np.arange(len(world))[:, None]
        around = np.where(stays, kinds, world.colour[world.next_state[:, :4]])
        seen.append(np.eye(kinds + 1)[around].reshape(len(world), -1))
    return np.concatenate(seen, axis=1).astype(np.float32)
