"""The maps of LanguageGridCraft: drawn as text or grown from a seed, and sound before anyone walks on them."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

COLOURS = ("red", "green", "blue", "yellow")
WALL = -1
WHITE = 0  # the colour COLOURS[i] is number i + 1
SYMBOLS = {"#": WALL, ".": WHITE, "R": 1, "G": 2, "B": 3, "Y": 4}
ATTEMPTS = 200


def colour_number(colour: str) -> int:
    """The number of a colour in Layout.cells, from 1."""
    if colour not in COLOURS:
        raise ValueError(f"there is no colour {colour!r} in the grid: wanted one of {', '.join(COLOURS)}")
    return COLOURS.index(colour) + 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """One map. Every open cell can be reached from every other, and at least one is white."""

    name: str
    cells: NDArray[np.int8]  # [H, W] -1 wall, 0 white, i + 1 COLOURS[i]; not to be written to

    def __post_init__(self) -> None:
        if self.cells.ndim != 2:
            raise ValueError(f"layout {self.name!r} has cells of shape {self.cells.shape}, wanted [height, width]")
        legal = (self.cells >= WALL) & (self.cells <= len(COLOURS))
        if not legal.all():
            raise ValueError(f"layout {self.name!r} holds {self.cells[~legal][0]}, wanted {WALL} to {len(COLOURS)}")
        if not (self.cells == WHITE).any():
            raise ValueError(f"layout {self.name!r} has no white cell: there is nowhere to start")
        if not connected(self.cells != WALL):
            raise ValueError(f"layout {self.name!r} falls apart: walls cut some open cells off from the others")
        self.cells.setflags(write=False)

    @classmethod
    def draw(cls, name: str, drawing: str) -> Layout:
        """A layout from lines of `R G B Y` (regions), `#` (wall) and `.` (white)."""
        lines = drawing.split()
        if not lines:
            raise ValueError(f"layout {name!r} is empty: wanted lines of {' '.join(SYMBOLS)}")
        for number, line in enumerate(lines, start=1):
            if len(line) != len(lines[0]):
                raise ValueError(f"layout {name!r}, line {number} has {len(line)} cells, line 1 has {len(lines[0])}")
            if unknown := set(line) - set(SYMBOLS):
                raise ValueError(f"layout {name!r}, line {number} has {min(unknown)!r}, wanted {' '.join(SYMBOLS)}")
        cells = np.array([[SYMBOLS[symbol] for symbol in line] for line in lines], dtype=np.int8)
        return cls(name=name, cells=cells)

    @property
    def drawing(self) -> str:
        """The layout as text, one line a row: what `draw` reads."""
        symbol = {number: symbol for symbol, number in SYMBOLS.items()}
        return "\n".join("".join(symbol[int(cell)] for cell in row) for row in self.cells)

    @property
    def colours(self) -> tuple[str, ...]:
        """The colours that occur, in the order of COLOURS."""
        return tuple(colour for number, colour in enumerate(COLOURS, start=1) if (self.cells == number).any())


def spread(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """[H, W] the marked cells and their four neighbours."""
    wide = mask.copy()
    wide[1:] |= mask[:-1]
    wide[:-1] |= mask[1:]
    wide[:, 1:] |= mask[:, :-1]
    wide[:, :-1] |= mask[:, 1:]
    return wide


def connected(mask: NDArray[np.bool_]) -> bool:
    """Whether one can walk between any two of the marked cells over marked cells; True when none is marked."""
    reached = np.zeros_like(mask)
    reached.flat[np.argmax(mask)] = mask.any()
    while (wider := spread(reached) & mask).sum() > reached.sum():
        reached = wider
    return bool((reached == mask).all())


def reachable_cleanly(cells: NDArray[np.int8]) -> bool:
    """Whether every coloured region can be walked to from every white cell over white cells alone."""
    white = cells == WHITE
    numbers = np.unique(cells[cells > WHITE])
    return bool(white.any()) and connected(white) and all((spread(cells == n) & white).any() for n in numbers)


@functools.lru_cache(maxsize=256)
def random_layout(
    seed: int,
    *,
    height: int = 8,
    width: int = 8,
    colours: tuple[str, ...] = COLOURS[:3],
    region_cells: int = 4,
    wall_cells: int = 6,
) -> Layout:
    """The layout of a seed: one region of each colour, and every one can be reached without touching another.

    The goal can therefore always be had without entering the colour to avoid.
    """
    numbers = [colour_number(colour) for colour in colours]
    if not colours or len(set(colours)) != len(colours):
        raise ValueError(f"a random layout got the colours {colours}: wanted one or more, each once")
    if seed < 0 or region_cells < 1 or wall_cells < 0:
        raise ValueError(
            f"a random layout got seed {seed}, {region_cells} cells a region and {wall_cells} walls: "
            "wanted at least 0, 1 and 0"
        )
    rng = np.random.default_rng(seed)
    for _ in range(ATTEMPTS):
        cells = np.full((height, width), WHITE, dtype=np.int8)
        grown = all(_grow(cells, number, region_cells, rng) for number in numbers)
        if grown and reachable_cleanly(cells) and _build_walls(cells, wall_cells, rng):
            return Layout(name=f"random-{seed}", cells=cells)
    raise ValueError(
        f"no layout of {height}x{width} found for {len(colours)} regions of {region_cells} cells and "
        f"{wall_cells} walls in {ATTEMPTS} attempts: wanted more cells, smaller regions or fewer walls"
    )


def _grow(cells: NDArray[np.int8], number: int, size: int, rng: np.random.Generator) -> bool:
    """Colour `size` connected white cells in place; False when there is no room."""
    region = np.zeros(cells.shape, dtype=np.bool_)
    for _ in range(size):
        frontier = spread(region) if region.any() else np.ones(cells.shape, dtype=np.bool_)
        free = np.flatnonzero(frontier & (cells == WHITE))
        if free.size == 0:
            return False
        cell = rng.choice(free)
        region.flat[cell] = True
        cells.flat[cell] = number
    return True


def _build_walls(cells: NDArray[np.int8], count: int, rng: np.random.Generator) -> bool:
    """Wall `count` white cells up in place, none that would cut a way off; False when so many do not fit."""
    for cell in rng.permutation(np.flatnonzero(cells == WHITE)):
        if count == 0:
            break
        cells.flat[cell] = WALL
        if reachable_cleanly(cells):
            count -= 1
        else:
            cells.flat[cell] = WHITE
    return count == 0


LAYOUTS = {
    name: Layout.draw(name, drawing)
    for name, drawing in {
        # Three regions in an open field, as in figures 4.1 and 4.3 of the thesis.
        "regions": """
            RR....GG
            RR....GG
            ........
            ........
            ...BB...
            ...BB...
            ........
            ........""",
        # Blue lies across the straight way from the lower half to red and to green.
        "detour": """
            RR....GG
            RR....GG
            ........
            .BBBBBB.
            .BBBBBB.
            ........
            ........
            ........""",
        "rooms": """
            RR.#..GG
            R..#...G
            ........
            ##.##.##
            ...#....
            ........
            .BB#....
            BBB#....""",
        "corridor": """
            RR.#...#
            RR.#.#.#
            ...#.#..
            .#...##.
            .#####G.
            .BB..#GG
            .BB#.#.G
            ........""",
        # Each colour has two regions: the nearer one is the goal to go for.
        "twins": """
            RR....BB
            R......B
            ...GG...
            ........
            ........
            ...GG...
            B......R
            BB....RR""",
        "four": """
            RR....GG
            RR....GG
            ........
            ...##...
            ...##...
            ........
            BB....YY
            BB....YY""",
        "mosaic": """
            ..RR..GG
            .......G
            .#.BB...
            .#..B.Y.
            .#....YY
            .##.....
            R...#.BB
            RR..#..B""",
    }.items()
}


def named_layout(name: str) -> Layout:
    """The layout of this name."""
    if name not in LAYOUTS:
        raise ValueError(f"there is no layout {name!r}: wanted one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
