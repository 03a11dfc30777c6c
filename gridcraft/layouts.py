"""The maps of LanguageGridCraft: parsed from text or generated from a seed, and validated when they are built."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

COLOURS = ("red", "green", "blue", "yellow")
WALL = -1
WHITE = 0  # the colour COLOURS[i] is number i + 1
SYMBOLS = {"#": WALL, ".": WHITE, "R": 1, "G": 2, "B": 3, "Y": 4}
SYMBOL_OF = {number: symbol for symbol, number in SYMBOLS.items()}
MAX_ATTEMPTS = 200


def colour_number(colour: str) -> int:
    """The number of a colour in Layout.cells, from 1. ValueError for an unknown colour."""
    if colour not in COLOURS:
        raise ValueError(f"there is no colour {colour!r} in the grid: wanted one of {', '.join(COLOURS)}")
    return COLOURS.index(colour) + 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """One map. All cells that are no wall are connected, and at least one of them is white; otherwise ValueError."""

    name: str
    cells: NDArray[np.int8]  # [H, W] -1 wall, 0 white, i + 1 COLOURS[i]; read-only

    def __post_init__(self) -> None:
        if self.cells.ndim != 2:
            raise ValueError(f"layout {self.name!r} has cells of shape {self.cells.shape}, wanted [height, width]")
        legal = (self.cells >= WALL) & (self.cells <= len(COLOURS))
        if not legal.all():
            raise ValueError(f"layout {self.name!r} holds {self.cells[~legal][0]}, wanted {WALL} to {len(COLOURS)}")
        if not (self.cells == WHITE).any():
            raise ValueError(f"layout {self.name!r} has no white cell, wanted at least one to start on")
        if not is_connected(self.cells != WALL):
            raise ValueError(f"layout {self.name!r} is not connected: walls separate some of its cells from the others")
        self.cells.setflags(write=False)

    @classmethod
    def parse(cls, name: str, drawing: str) -> Layout:
        """A layout from lines of `R G B Y` (regions), `#` (wall) and `.` (white). ValueError for malformed lines."""
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
        """The layout as text, one line per row, in the format that `parse` reads."""
        return "\n".join("".join(SYMBOL_OF[int(cell)] for cell in row) for row in self.cells)

    @property
    def colours(self) -> tuple[str, ...]:
        """The colours of the regions on the map, in the order of COLOURS."""
        return tuple(colour for number, colour in enumerate(COLOURS, start=1) if (self.cells == number).any())


def dilate(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """[H, W] the marked cells and their four neighbours (morphological dilation)."""
    dilated = mask.copy()
    dilated[1:] |= mask[:-1]
    dilated[:-1] |= mask[1:]
    dilated[:, 1:] |= mask[:, :-1]
    dilated[:, :-1] |= mask[:, 1:]
    return dilated


def is_connected(mask: NDArray[np.bool_]) -> bool:
    """Whether the marked cells [H, W] form one 4-connected component; True when none is marked."""
    reached = np.zeros_like(mask)
    reached.flat[np.argmax(mask)] = mask.any()
    while (wider := dilate(reached) & mask).sum() > reached.sum():
        reached = wider
    return bool((reached == mask).all())


def regions_reachable(cells: NDArray[np.int8]) -> bool:
    """Whether every colour can be reached from every white cell of [H, W] by walking over white cells only."""
    white = cells == WHITE
    numbers = np.unique(cells[cells > WHITE])
    return bool(white.any()) and is_connected(white) and all((dilate(cells == n) & white).any() for n in numbers)


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
    """Generate the layout of a seed, with one region per colour.

    Every region can be reached over white cells only, so the goal never requires entering the avoided colour.
    ValueError for illegal sizes, and when no layout was found in MAX_ATTEMPTS attempts.
    """
    numbers = [colour_number(colour) for colour in colours]
    if not colours or len(set(colours)) != len(colours):
        raise ValueError(f"a random layout got the colours {colours}: wanted at least one, each once")
    if seed < 0 or region_cells < 1 or wall_cells < 0:
        raise ValueError(
            f"a random layout got seed {seed}, {region_cells} cells per region and {wall_cells} walls: "
            "wanted at least 0, 1 and 0"
        )
    rng = np.random.default_rng(seed)
    for _ in range(MAX_ATTEMPTS):
        cells = np.full((height, width), WHITE, dtype=np.int8)
        grown = all(_grow_region(cells, number, region_cells, rng) for number in numbers)
        if grown and regions_reachable(cells) and _build_walls(cells, wall_cells, rng):
            return Layout(name=f"random-{seed}", cells=cells)
    raise ValueError(
        f"no layout of {height}x{width} found for {len(colours)} regions of {region_cells} cells and "
        f"{wall_cells} walls in {MAX_ATTEMPTS} attempts: wanted more cells, smaller regions or fewer walls"
    )


def _grow_region(cells: NDArray[np.int8], number: int, size: int, rng: np.random.Generator) -> bool:
    """Colour `size` connected white cells in place; False when there are too few."""
    region = np.zeros(cells.shape, dtype=np.bool_)
    for _ in range(size):
        frontier = dilate(region) if region.any() else np.ones(cells.shape, dtype=np.bool_)
        free = np.flatnonzero(frontier & (cells == WHITE))
        if free.size == 0:
            return False
        cell = rng.choice(free)
        region.flat[cell] = True
        cells.flat[cell] = number
    return True


def _build_walls(cells: NDArray[np.int8], count: int, rng: np.random.Generator) -> bool:
    """Turn `count` white cells into walls in place, keeping all regions reachable; False if too few can be turned."""
    for cell in rng.permutation(np.flatnonzero(cells == WHITE)):
        if count == 0:
            break
        cells.flat[cell] = WALL
        if regions_reachable(cells):
            count -= 1
        else:
            cells.flat[cell] = WHITE
    return count == 0


LAYOUTS = {
    name: Layout.parse(name, drawing)
    for name, drawing in {
        # Three regions without walls, as in figures 4.1 and 4.3 of the thesis.
        "regions": """
            RR....GG
            RR....GG
            ........
            ........
            ...BB...
            ...BB...
            ........
            ........""",
        # Blue blocks the direct path from the lower half to red and green.
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
        # Each colour has two regions; the optimal policy goes to the nearer one.
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
    """The layout of this name. ValueError for an unknown name."""
    if name not in LAYOUTS:
        raise ValueError(f"there is no layout {name!r}: wanted one of {', '.join(LAYOUTS)}")
    return LAYOUTS[name]
