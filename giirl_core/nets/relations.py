"""Relations of the elements of a page: in the tree, on the screen, labels of fields, and rows of tables."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.layout import SCREEN_RELATIONS
from giirl_core.types import Page

NONE = -1  # no label, no group
LABEL_STEPS = 5  # the largest distance of a field from its label in the tree
LINE = 0.6  # two elements are in one line or column if their centres differ by less than this fraction of their sizes
DIAGONAL = 0.1  # two elements are on a diagonal if horizontal and vertical distance differ by less than this fraction
VERTICAL_WEIGHT = 3.0  # a vertical pixel between a field and its label counts as this many horizontal ones
BELOW_PX, BELOW_COST_PX = 4.0, 50.0  # labels are seldom below their field
_FIELDS = ("input_", "textarea", "select")  # prefixes of tags of fields
_NO_LABELS = frozenset({"button", "option", "textarea"})  # tags whose text is no label
# Relations on the screen, of the element in the column to the element in the row of a table [E, E].
_SAME_PLACE, _LEFT, _RIGHT, _ABOVE, _BELOW, _ELSEWHERE, _FALLING, _RISING = range(SCREEN_RELATIONS)


def _screen_relation(code: int) -> int:
    """The relation for the bits 8 same line, 4 same column, 2 to the left, 1 above."""
    if code & 12 == 12:
        return _SAME_PLACE
    if code & 8:
        return _LEFT if code & 2 else _RIGHT
    if code & 4:
        return _ABOVE if code & 1 else _BELOW
    return _ELSEWHERE


_SCREEN = np.array([_screen_relation(code) for code in range(16)], dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class Structure:
    """The relations of the E elements of a page."""

    relations: NDArray[np.uint8]  # [E, E] relation of the element in the column to that in the row, below RELATIONS
    label: NDArray[np.int64]  # [E] row of the text that labels a field, NONE for other elements
    group: NDArray[np.int64]  # [E] row of the nearest repeated ancestor, e.g. a row of a table; NONE without one
    rank: NDArray[np.int64]  # [E] from 1, among the elements with the same tag and first class
    alike: NDArray[np.int64]  # [E] number of elements with the same tag and first class


def structure_of(page: Page) -> Structure:
    """The relations of the elements of a page, from the cache if only values or words of texts differ."""
    kinds = tuple([(tag, classes.partition(" ")[0]) for tag, classes in zip(page.tag, page.classes, strict=True)])
    has_text = tuple([text != "" for text in page.text])
    return _structure(kinds, has_text, page.parent.astype(np.int16).tobytes(), page.box.astype(np.float32).tobytes())


@functools.lru_cache(maxsize=1 << 10)
def _structure(kinds: tuple[tuple[str, str], ...], has_text: tuple[bool, ...], parent: bytes, box: bytes) -> Structure:
    """The structure of a page from the tag and first class of each element, its parent and box."""
    parents = np.frombuffer(parent, dtype=np.int16).tolist()
    siblings: dict[tuple[int, tuple[str, str]], int] = {}
    counts: dict[tuple[str, str], int] = {}
    ranks = []
    for at, kind in zip(parents, kinds, strict=True):
        siblings[at, kind] = siblings.get((at, kind), 0) + 1
        counts[kind] = counts.get(kind, 0) + 1
        ranks.append(counts[kind])
    group: list[int] = []
    for at in parents:
        repeated = at >= 0 and siblings[parents[at], kinds[at]] > 1
        group.append(at if repeated else group[at] if at >= 0 else NONE)
    tree, steps = _tree(parent)
    boxes: NDArray[np.float32] = np.frombuffer(box, dtype=np.float32).reshape(-1, 4)
    left, top, width, height = boxes.T
    x, y = left + width / 2, top + height / 2
    right, down = x - x[:, None], y - y[:, None]  # from the row to the column
    wide, high = (width + width[:, None]) / 2, (height + height[:, None]) / 2
    horizontal, vertical = np.abs(right), np.abs(down)
    code = (vertical < high * LINE) * np.uint8(8) + (horizontal < wide * LINE) * np.uint8(4)
    code += (right < 0) * np.uint8(2) + (down < 0) * np.uint8(1)
    screen = _SCREEN[code]
    slanted = np.abs(horizontal - vertical) < DIAGONAL * np.maximum(horizontal, vertical)
    slanted &= screen == _ELSEWHERE
    falling = right * down > 0
    screen[slanted & falling], screen[slanted & ~falling] = _FALLING, _RISING
    return Structure(
        relations=tree + screen,
        label=_labels([tag for tag, _ in kinds], has_text, steps, horizontal - wide, vertical - high, down),
        group=np.array(group, dtype=np.int64),
        rank=np.array(ranks, dtype=np.int64),
        alike=np.array([counts[kind] for kind in kinds], dtype=np.int64),
    )


@functools.lru_cache(maxsize=512)
def _tree(parents: bytes) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """[E, E] SCREEN_RELATIONS * relation in the tree, and the number of steps in the tree between two elements.

    Relations: 0 the same element, 1 parent, 2 other ancestor, 3 child, 4 other descendant, 5 to 10 others by distance.
    """
    parent = np.frombuffer(parents, dtype=np.int16).tolist()
    above = np.zeros((len(parent), len(parent)), dtype=np.float32)  # 1 for ancestors and the element itself
    for row, at in enumerate(parent):
        if at >= 0:
            above[row] = above[at]
        above[row, row] = 1.0
    common = above @ above.T
    depth = np.diagonal(common)
    steps = depth[:, None] + depth[None, :] - 2 * common
    tree = np.clip(steps, 2, 7) + 3
    ancestor, descendant = common == depth[None, :], common == depth[:, None]
    tree[ancestor] = np.where(steps[ancestor] == 1, 1, 2)
    tree[descendant] = np.where(steps[descendant] == 1, 3, 4)
    np.fill_diagonal(tree, 0)
    return (tree * SCREEN_RELATIONS).astype(np.uint8), np.minimum(steps, 255).astype(np.uint8)


def _labels(
    tags: Sequence[str],
    has_text: Sequence[bool],
    steps: NDArray[np.uint8],
    horizontal_gap: NDArray[np.float32],
    vertical_gap: NDArray[np.float32],
    down: NDArray[np.float32],
) -> NDArray[np.int64]:
    """[E] for each field the text with the fewest steps in the tree; of several, the nearest one on the screen."""
    label = np.full(len(tags), NONE, dtype=np.int64)
    fields = [row for row, tag in enumerate(tags) if tag.startswith(_FIELDS) and tag != "input_submit"]
    texts = [row for row, shown in enumerate(has_text) if shown and tags[row] not in _NO_LABELS]
    if not fields or not texts:
        return label
    some = np.ix_(fields, texts)
    pixels = np.maximum(horizontal_gap[some], 0) + VERTICAL_WEIGHT * np.maximum(vertical_gap[some], 0)
    cost = steps[some].astype(np.float32) * 1000.0 + pixels + (down[some] > BELOW_PX) * BELOW_COST_PX
    best = cost.argmin(axis=1)
    near = steps[some][np.arange(len(fields)), best] <= LABEL_STEPS
    label[fields] = np.where(near, np.array(texts, dtype=np.int64)[best], NONE)
    return label
