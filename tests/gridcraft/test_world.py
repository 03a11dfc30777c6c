"""Layouts parse and generate as specified, and the transition table agrees with moves on the drawing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridcraft.instructions import ColourPair
from gridcraft.layouts import COLOURS, LAYOUTS, WALL, Layout, named_layout, random_layout, regions_reachable
from gridcraft.world import (
    ACTIONS,
    build_world,
    expected_value,
    observations,
    sample_starts,
    step,
    transitions,
    true_reward,
)

SMALL = Layout.parse("small", "R.# ... .BG")
UP, DOWN, LEFT, RIGHT, STAY = range(len(ACTIONS))


@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_every_region_of_a_named_layout_is_reachable_over_white_cells(name: str) -> None:
    assert regions_reachable(LAYOUTS[name].cells)
    assert len(LAYOUTS[name].colours) >= 2


@pytest.mark.parametrize("layout", [*LAYOUTS.values(), random_layout(3)], ids=lambda layout: layout.name)
def test_parsing_the_drawing_of_a_layout_gives_the_same_layout(layout: Layout) -> None:
    assert (Layout.parse("copy", layout.drawing).cells == layout.cells).all()


@pytest.mark.parametrize(
    ("drawing", "message"),
    [
        ("", "is empty"),
        ("R.. ..", "line 2 has 2 cells, line 1 has 3"),
        ("R.. .x.", "line 2 has 'x'"),
        ("RR GG", "no white cell"),
        (".#. .#R", "is not connected"),
        ("##", "no white cell"),
    ],
)
def test_a_malformed_drawing_is_an_error_that_names_the_reason(drawing: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Layout.parse("bad", drawing)


def test_illegal_layout_names_colours_and_slips_are_errors() -> None:
    with pytest.raises(ValueError, match="wanted one of regions"):
        named_layout("region")
    with pytest.raises(ValueError, match="no blue cell"):
        true_reward(build_world([Layout.parse("two", "R.G")]), ColourPair("red", "blue"))
    with pytest.raises(ValueError, match="at least one layout"):
        build_world([])
    with pytest.raises(ValueError, match="wanted a probability"):
        build_world([SMALL], slip=1.5)


@given(
    st.integers(0, 2**32),
    st.integers(5, 9),
    st.integers(5, 9),
    st.sampled_from([COLOURS[:2], COLOURS, ("yellow", "red")]),
    st.integers(1, 4),
    st.integers(0, 4),
)
def test_a_random_layout_has_the_requested_cells_and_reachable_regions(
    seed: int, height: int, width: int, colours: tuple[str, ...], region_cells: int, wall_cells: int
) -> None:
    layout = random_layout(
        seed, height=height, width=width, colours=colours, region_cells=region_cells, wall_cells=wall_cells
    )
    assert layout.cells.shape == (height, width)
    assert set(layout.colours) == set(colours)
    assert np.count_nonzero(layout.cells > 0) == region_cells * len(colours)
    assert np.count_nonzero(layout.cells == WALL) == wall_cells
    assert regions_reachable(layout.cells)


def test_the_seed_determines_the_random_layout() -> None:
    drawings = [random_layout(seed).drawing for seed in range(20)]
    assert drawings == [random_layout(seed).drawing for seed in range(20)]
    assert len(set(drawings)) == 20


def test_an_impossible_random_layout_is_an_error() -> None:
    with pytest.raises(ValueError, match="wanted more cells"):
        random_layout(0, height=3, width=3, region_cells=3)
    with pytest.raises(ValueError, match="each once"):
        random_layout(0, colours=("red", "red"))
    with pytest.raises(ValueError, match="no colour 'pink'"):
        random_layout(0, colours=("pink",))


@pytest.mark.parametrize("layout", [SMALL, LAYOUTS["corridor"]], ids=lambda layout: layout.name)
def test_the_transition_table_agrees_with_moves_on_the_drawing(layout: Layout) -> None:
    world, rows = build_world([layout]), layout.drawing.split()
    state = {tuple(map(int, position)): s for s, position in enumerate(world.position)}
    assert len(state) == len(world) == sum(cell != "#" for row in rows for cell in row)
    for (row, column), s in state.items():
        assert ".RGBY"[world.colour[s]] == rows[row][column]
        for action, (down, right) in enumerate([(-1, 0), (1, 0), (0, -1), (0, 1), (0, 0)]):
            assert world.next_state[s, action] == state.get((row + down, column + right), s)


def test_layouts_of_one_world_are_disconnected_and_equally_likely_at_the_start() -> None:
    layouts = [SMALL, LAYOUTS["four"], random_layout(1)]
    world = build_world(layouts)
    assert (world.layout[world.next_state] == world.layout[:, None]).all()
    assert np.bincount(world.layout, weights=world.start) == pytest.approx([1 / 3] * 3)
    assert (world.start[world.colour > 0] == 0).all()
    alone = build_world([layouts[1]])
    here = world.layout == 1
    assert (world.next_state[here] - np.flatnonzero(here)[0] == alone.next_state).all()
    assert (observations(world)[here] == observations(alone)).all()


def test_the_true_reward_depends_on_the_cell_of_the_agent() -> None:
    world = build_world([SMALL])
    #          R  .  .  .  .  .  B  G
    expected = [1, 0, 0, 0, 0, 0, -1, 0]
    assert (true_reward(world, ColourPair("red", "blue")) == np.array(expected)[:, None]).all()
    assert (true_reward(world, ColourPair("blue", "red")) == -np.array(expected)[:, None]).all()


@pytest.mark.parametrize("slip", [0.0, 0.3, 1.0])
def test_transitions_are_probabilities_and_expected_value_is_their_mean(slip: float) -> None:
    world = build_world([LAYOUTS["rooms"]], slip)
    table, value = transitions(world), np.random.default_rng(0).normal(size=len(world))
    assert table.sum(axis=2) == pytest.approx(1.0)
    assert (table >= 0).all()
    assert expected_value(world, value) == pytest.approx(table @ value)


def test_slipping_agents_follow_the_transition_probabilities() -> None:
    world, rng = build_world([SMALL], slip=0.5), np.random.default_rng(7)
    agents = 20_000
    for s, a in itertools.product((1, 3), (UP, STAY)):
        after = step(world, np.full(agents, s), np.full(agents, a), rng)
        frequency = np.bincount(after, minlength=len(world)) / agents
        assert np.abs(frequency - transitions(world)[s, a]).max() < 0.02


def test_many_agents_step_at_once_and_the_seed_determines_their_states() -> None:
    world = build_world([SMALL, LAYOUTS["regions"]], slip=0.2)

    def play() -> list[list[int]]:
        rng = np.random.default_rng(5)
        states = [sample_starts(world, 64, rng)]
        for _ in range(10):
            states.append(step(world, states[-1], rng.integers(5, size=64), rng))
        return [list(map(int, now)) for now in states]

    assert play() == play()
    assert (world.start[play()[0]] > 0).all()
    assert set(world.layout[play()[0]]) == {0, 1}


def test_an_observation_contains_position_colour_and_adjacent_cells() -> None:
    world = build_world([SMALL])
    found = observations(world)
    assert found.shape == (8, 31)
    assert observations(world, adjacent_cells=False).shape == (8, 7)
    assert list(found[0, :7]) == [-1, -1, 0, 1, 0, 0, 0]  # upper left, on red
    adjacent = found[0, 7:].reshape(4, 6).argmax(axis=1)
    assert list(adjacent) == [5, 0, 5, 0]  # edge, white below, edge, white to the right
    assert list(found[6, 7:].reshape(4, 6).argmax(axis=1)) == [0, 5, 0, 2]  # on blue, with green to the right


def test_the_tables_of_a_world_are_read_only() -> None:
    world = build_world([SMALL])
    with pytest.raises(ValueError, match="read-only"):
        world.next_state[0, 0] = 3
    with pytest.raises(ValueError, match="read-only"):
        SMALL.cells[0, 0] = 0
