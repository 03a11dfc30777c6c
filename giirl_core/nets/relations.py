"""How the elements of a page stand to each other: in the tree, on the screen, and as labels and rows."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import Page

TREE = 11  # kinds of relation in the tree
SCREEN = 8  # kinds of relation on the screen
RELATIONS = TREE * SCREEN
NONE = -1
FIELD_TAGS = ("input_", "textarea", "select")
LABEL_DISTANCE = 5  # steps through the tree from a field to its label at most
OVERLAP = 0.6  # share of two sizes by which centres may differ in one line or column
SLANT = 0.1  # share by which a way across and one down may differ on a diagonal
# From (level, upright, to the left, above) to over it, left, right, above, below, elsewhere.
_SCREENS = np.array(
    [0 if n & 12 == 12 else 1 + (not n & 2) if n & 8 else 3 + (not n & 1) if n & 4 else 5 for n in range(16)], np.uint8
)
DOWN = 3.0  # a vertical pixel between a field and its label counts as so many horizontal ones


@dataclass(frozen=True, slots=True)
class Structure:
    """Of a page of E elements."""

    relations: NDArray[np.uint8]  # [E, E] what column is to row, in [0, RELATIONS)
    label: NDArray[np.int64]  # [E] row of the text that names a field, NONE for other elements
    group: NDArray[np.int64]  # [E] row of the nearest ancestor that repeats, as a row of a table does; NONE
    rank: NDArray[np.int64]  # [E] from 1, among the elements that look alike
    alike: NDArray[np.int64]  # [E] how many look alike


def structure_of(page: Page) -> Structure:
    """The relations of a page's elements."""
    count = len(page)
    parent = page.parent.astype(np.int64)
    looks = [(tag, classes.split(" ", 1)[0]) for tag, classes in zip(page.tag, page.classes, strict=True)]
    siblings: dict[tuple[int, tuple[str, str]], int] = {}
    seen: dict[tuple[str, str], int] = {}
    rank = np.zeros(count, dtype=np.int64)
    for row, at in enumerate(parent.tolist()):
        key = (at, looks[row])
        siblings[key] = siblings.get(key, 0) + 1
        rank[row] = seen[looks[row]] = seen.get(looks[row], 0) + 1
    group = np.full(count, NONE, dtype=np.int64)
    for row, at in enumerate(parent.tolist()):
        if at >= 0:
            group[row] = at if siblings[(int(parent[at]), looks[at])] > 1 else group[at]
    tree, distance = _tree(page.parent.tobytes())
    left, top, width, height = page.box.astype(np.float32).T
    across, down = _offsets(left + width / 2), _offsets(top + height / 2)  # from row to column
    wide, high = (width + width[:, None]) / 2, (height + height[:, None]) / 2
    aside, apart = np.abs(across), np.abs(down)
    code = (apart < high * OVERLAP) * np.uint8(8) + (aside < wide * OVERLAP) * np.uint8(4)
    code += (across < 0) * np.uint8(2) + (down < 0) * np.uint8(1)
    screen = _SCREENS[code]
    slanted = (np.abs(aside - apart) < SLANT * np.maximum(aside, apart)) & (screen == 5)
    screen[slanted & (across * down > 0)], screen[slanted & (across * down < 0)] = 6, 7
    return Structure(
        relations=tree + screen,
        label=_labels(page, distance, aside - wide, apart - high, down),
        group=group,
        rank=rank,
        alike=np.array([seen[look] for look in looks], dtype=np.int64),
    )


@functools.lru_cache(maxsize=512)
def _tree(parents: bytes) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """[E, E] codes of relations in the tree, times SCREEN, and steps through it from each element to each."""
    parent = np.frombuffer(parents, dtype=np.int16).tolist()
    above = np.zeros((len(parent), len(parent)), dtype=np.float32)
    for row, at in enumerate(parent):
        if at >= 0:
            above[row] = above[at]
        above[row, row] = 1.0
    shared = above @ above.T  # ancestors in common, themselves included
    depth = np.diagonal(shared)
    distance = depth[:, None] + depth[None, :] - 2 * shared
    tree = np.clip(distance, 2, 7) + 3  # 5 .. 10
    up, down = shared == depth[None, :], shared == depth[:, None]
    tree[up] = np.where(distance[up] == 1, 1, 2)
    tree[down] = np.where(distance[down] == 1, 3, 4)
    np.fill_diagonal(tree, 0)
    return (tree * SCREEN).astype(np.uint8), np.minimum(distance, 255).astype(np.uint8)


def _offsets(centre: NDArray[np.float32]) -> NDArray[np.float32]:
    return centre[None, :] - centre[:, None]


def _labels(
    page: Page,
    distance: NDArray[np.uint8],
    across: NDArray[np.float32],
    apart: NDArray[np.float32],
    down: NDArray[np.float32],
) -> NDArray[np.int64]:
    """For each field the nearest text in the tree; of equals the one nearest on the screen."""
    label = np.full(len(page), NONE, dtype=np.int64)
    fields = [row for row, tag in enumerate(page.tag) if tag.startswith(FIELD_TAGS) and tag != "input_submit"]
    if not fields:
        return label
    texts = np.array(
        [row for row, text in enumerate(page.text) if text and page.tag[row] not in ("button", "option", "textarea")],
        dtype=np.int64,
    )
    if not len(texts):
        return label
    for row in fields:
        near = distance[row, texts]
        pixels = np.maximum(across[row, texts], 0) + DOWN * np.maximum(apart[row, texts], 0)
        after = (down[row, texts] > 4.0) * 50.0  # a label stands before its field, or beside it
        cost = near.astype(np.float32) * 1000.0 + pixels + after
        best = int(cost.argmin())
        if near[best] <= LABEL_DISTANCE:
            label[row] = texts[best]
    return label
