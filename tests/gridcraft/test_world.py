"""The world: drawings, seeds, and a table of steps held against moving on the drawing by hand."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridcraft.instructions import Pair
from gridcraft.layouts import COLOURS, LAYOUTS, WALL, Layout, named_layout, random_layout, reachable_cleanly
from gridcraft.world import (
    ACTIONS,
    build_world,
    draw_starts,
    expected_value,
    observations,
    step,
    transitions,
    true_reward,
)

SMALL = Layout.draw("small", "R.# ... .BG")
UP, DOWN, LEFT, RIGHT, STAY = range(len(ACTIONS))


@pytest.mark.parametrize("name", sorted(LAYOUTS))
def test_a_named_layout_lets_every_colour_be_reached_without_touching_another(name: str) -> None:
    assert reachable_cleanly(LAYOUTS[name].cells)
    assert len(LAYOUTS[name].colours) >= 2


@pytest.mark.parametrize("layout", [*LAYOUTS.values(), random_layout(3)], ids=lambda layout: layout.name)
def test_a_layout_drawn_from_its_own_drawing_is_the_same(layout: Layout) -> None:
    assert (Layout.draw("copy", layout.drawing).cells == layout.cells).all()


@pytest.mark.parametrize(
    ("drawing", "complaint"),
    [
        ("", "is empty"),
        ("R.. ..", "line 2 has 2 cells, line 1 has 3"),
        ("R.. .x.", "line 2 has 'x'"),
        ("RR GG", "no white cell"),
        (".#. .#R", "falls apart"),
        ("##", "no white cell"),
    ],
)
def test_a_drawing_that_is_no_layout_is_refused_with_its_reason(drawing: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        Layout.draw("bad", drawing)


def test_what_is_not_there_is_refused_with_what_is() -> None:
    with pytest.raises(ValueError, match="wanted one of regions"):
        named_layout("region")
    with pytest.raises(ValueError, match="no blue cell"):
        true_reward(build_world([Layout.draw("two", "R.G")]), Pair("red", "blue"))
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
def test_a_random_layout_has_what_was_asked_and_a_clean_way_to_every_region(
    seed: int, height: int, width: int, colours: tuple[str, ...], region_cells: int, wall_cells: int
) -> None:
    layout = random_layout(
        seed, height=height, width=width, colours=colours, region_cells=region_cells, wall_cells=wall_cells
    )
    assert layout.cells.shape == (height, width)
    assert set(layout.colours) == set(colours)
    assert np.count_nonzero(layout.cells > 0) == region_cells * len(colours)
    assert np.count_nonzero(layout.cells == WALL) == wall_cells
    assert reachable_cleanly(layout.cells)


def test_a_seed_is_a_layout_and_another_seed_another() -> None:
    drawings = [random_layout(seed).drawing for seed in range(20)]
    assert drawings == [random_layout(seed).drawing for seed in range(20)]
    assert len(set(drawings)) == 20


def test_a_random_layout_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="wanted more cells"):
        random_layout(0, height=3, width=3, region_cells=3)
    with pytest.raises(ValueError, match="each once"):
        random_layout(0, colours=("red", "red"))
    with pytest.raises(ValueError, match="no colour 'pink'"):
        random_layout(0, colours=("pink",))


@pytest.mark.parametrize("layout", [SMALL, LAYOUTS["corridor"]], ids=lambda layout: layout.name)
def test_the_table_of_steps_agrees_with_moving_on_the_drawing(layout: Layout) -> None:
    world, rows = build_world([layout]), layout.drawing.split()
    state = {tuple(map(int, place)): s for s, place in enumerate(world.position)}
    assert len(state) == len(world) == sum(cell != "#" for row in rows for cell in row)
    for (row, column), s in state.items():
        assert ".RGBY"[world.colour[s]] == rows[row][column]
        for action, (down, right) in enumerate([(-1, 0), (1, 0), (0, -1), (0, 1), (0, 0)]):
            assert world.next_state[s, action] == state.get((row + down, column + right), s)


def test_layouts_side_by_side_never_mix_and_start_alike_often() -> None:
    layouts = [SMALL, LAYOUTS["four"], random_layout(1)]
    world = build_world(layouts)
    assert (world.layout[world.next_state] == world.layout[:, None]).all()
    assert np.bincount(world.layout, weights=world.start) == pytest.approx([1 / 3] * 3)
    assert (world.start[world.colour > 0] == 0).all()
    alone = build_world([layouts[1]])
    here = world.layout == 1
    assert (world.next_state[here] - np.flatnonzero(here)[0] == alone.next_state).all()
    assert (observations(world)[here] == observations(alone)).all()


def test_the_true_reward_pays_for_the_cell_an_agent_stands_on() -> None:
    world = build_world([SMALL])
    #          R  .  .  .  .  .  B  G
    expected = [1, 0, 0, 0, 0, 0, -1, 0]
    assert (true_reward(world, Pair("red", "blue")) == np.array(expected)[:, None]).all()
    assert (true_reward(world, Pair("blue", "red")) == -np.array(expected)[:, None]).all()


@pytest.mark.parametrize("slip", [0.0, 0.3, 1.0])
def test_transitions_are_probabilities_and_expect_is_their_mean(slip: float) -> None:
    world = build_world([LAYOUTS["rooms"]], slip)
    table, value = transitions(world), np.random.default_rng(0).normal(size=len(world))
    assert table.sum(axis=2) == pytest.approx(1.0)
    assert (table >= 0).all()
    assert expected_value(world, value) == pytest.approx(table @ value)


def test_agents_that_slip_go_where_the_transitions_say() -> None:
    world, rng = build_world([SMALL], slip=0.5), np.random.default_rng(7)
    agents = 20_000
    for s, a in itertools.product((1, 3), (UP, STAY)):
        after = step(world, np.full(agents, s), np.full(agents, a), rng)
        seen = np.bincount(after, minlength=len(world)) / agents
        assert np.abs(seen - transitions(world)[s, a]).max() < 0.02


def test_many_agents_step_at_once_and_the_same_way_for_the_same_seed() -> None:
    world = build_world([SMALL, LAYOUTS["regions"]], slip=0.2)

    def play() -> list[list[int]]:
        rng = np.random.default_rng(5)
        states = [draw_starts(world, 64, rng)]
        for _ in range(10):
            states.append(step(world, states[-1], rng.integers(5, size=64), rng))
        return [list(map(int, now)) for now in states]

    assert play() == play()
    assert (world.start[play()[0]] > 0).all()
    assert set(world.layout[play()[0]]) == {0, 1}


def test_an_observation_shows_place_colour_and_what_lies_around() -> None:
    world = build_world([SMALL])
    seen = observations(world)
    assert seen.shape == (8, 31)
    assert observations(world, neighbours=False).shape == (8, 7)
    assert list(seen[0, :7]) == [-1, -1, 0, 1, 0, 0, 0]  # upper left, on red
    around = seen[0, 7:].reshape(4, 6).argmax(axis=1)
    assert list(around) == [5, 0, 5, 0]  # the edge, white below, the edge, white to the right
    assert list(seen[6, 7:].reshape(4, 6).argmax(axis=1)) == [0, 5, 0, 2]  # blue: green is to its right


def test_the_tables_of_a_world_cannot_be_written_to() -> None:
    world = build_world([SMALL])
    with pytest.raises(ValueError, match="read-only"):
        world.next_state[0, 0] = 3
    with pytest.raises(ValueError, match="read-only"):
        SMALL.cells[0, 0] = 0
