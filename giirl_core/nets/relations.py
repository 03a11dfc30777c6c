"""Relations of the elements of a page: in the tree, on the screen, labels of fields, and rows of tables."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.layout import (
    ALIKE_COUNT,
    GROUPED,
    HEIGHT_PX,
    LABELLED,
    LEAF,
    PAGE_FLAGS,
    POSITION,
    RANK,
    RANK_LAST,
    RANK_ONLY,
    SCREEN_RELATIONS,
    SIZE,
    WIDTH_PX,
)

NONE = -1  # no label, no group
LABEL_STEPS = 5  # the largest distance of a field from its label in the tree
LINE = 0.6  # two elements are in one line or column if their centres differ by less than this fraction of their sizes
DIAGONAL = 0.1  # two elements are on a diagonal if horizontal and vertical distance differ by less than this fraction
VERTICAL_WEIGHT = 3.0  # a vertical pixel between a field and its label counts as this many horizontal ones
BELOW_PX, BELOW_COST_PX = 4.0, 50.0  # labels are seldom below their field
_FIELDS = ("input_", "textarea", "select")  # prefixes of tags of fields
_NO_LABELS = frozenset({"button", "option", "textarea"})  # tags whose text is no label
_PAGE_PX = np.array([WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX])
_RANKS = np.arange(1, RANK.stop - RANK.start + 1)
# Relations on the screen, of the element in the column to the element in the row of a table [E, E].
_SAME_PLACE, _LEFT, _RIGHT, _ABOVE, _BELOW, _ELSEWHERE, _FALLING, _RISING = range(SCREEN_RELATIONS)


def _screen_relation(code: int) -> int:
    """The relation for the bits 16 slanted, 8 same line, 4 same column, 2 to the left, 1 above."""
    if code & 12 == 12:
        return _SAME_PLACE
    if code & 8:
        return _LEFT if code & 2 else _RIGHT
    if code & 4:
        return _ABOVE if code & 1 else _BELOW
    if code & 16:
        return _FALLING if code & 3 in (0, 3) else _RISING
    return _ELSEWHERE


def _tree_relation(code: int) -> int:
    """The relation for the bits 16 descendant or itself, 8 ancestor or itself, and the distance of at most 7 steps.

    0 the same element, 1 parent, 2 other ancestor, 3 child, 4 other descendant, 5 to 10 others by distance.
    """
    steps = code & 7
    if code & 24 == 24:
        return 0
    if code & 24:
        return (1 if code & 8 else 3) + (steps > 1)
    return max(steps, 2) + 3


_SCREEN = np.array([_screen_relation(code) for code in range(32)], dtype=np.uint8)
_TREE = np.array([SCREEN_RELATIONS * _tree_relation(code) for code in range(32)], dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class Structure:
    """The relations of the E elements of a page."""

    relations: NDArray[np.uint8]  # [E, E] relation of the element in the column to that in the row, below RELATIONS
    label: NDArray[np.int64]  # [E] row of the text that labels a field, NONE for other elements
    labelled: NDArray[np.int64]  # rows of the elements with a label
    group: NDArray[np.int64]  # [E] row of the nearest repeated ancestor, e.g. a row of a table; NONE without one
    own_group: NDArray[np.int64]  # [E] the same, with its own row for elements without a group
    kinds: Sequence[tuple[str, str]]  # [E] tag and first class
    rank: NDArray[np.int64]  # [E] from 1, among the elements with the same tag and first class
    alike: NDArray[np.int64]  # [E] number of elements with the same tag and first class
    leaf: NDArray[np.bool_]  # [E] True for elements without children
    height: NDArray[np.float32]  # [E] px
    flags: NDArray[np.float32]  # [E, PAGE_FLAGS] of positions, ranks, labels and groups; 0 in other columns


def structure_of(
    tags: Sequence[str], classes: Sequence[str], has_text: Sequence[bool], parents: bytes, boxes: bytes
) -> Structure:
    """The relations of the elements of a page, from the cache if only values or words of texts differ.

    `parents` are the bytes of int16 rows, `boxes` those of a float32 array [E, 4].
    """
    kinds = [(tag, names.partition(" ")[0]) for tag, names in zip(tags, classes, strict=True)]
    return _structure(tuple(kinds), tuple(has_text), parents, boxes)


@functools.lru_cache(maxsize=1 << 10)
def _structure(
    kinds: tuple[tuple[str, str], ...], has_text: tuple[bool, ...], parents: bytes, boxes: bytes
) -> Structure:
    group, rank, alike = _ranks(kinds, np.frombuffer(parents, dtype=np.int16).tolist())
    tree, steps, leaf = _tree(parents)
    box: NDArray[np.float32] = np.frombuffer(boxes, dtype=np.float32).reshape(-1, 4)
    half = box[:, 2:] / 2
    centre = box[:, :2] + half
    (x, y), (half_width, half_height) = centre.T, half.T
    right, down = x - x[:, None], y - y[:, None]  # from the row to the column
    wide, high = half_width + half_width[:, None], half_height + half_height[:, None]
    horizontal, vertical = np.abs(right), np.abs(down)
    slanted = np.abs(horizontal - vertical) < DIAGONAL * np.maximum(horizontal, vertical)
    bits = (slanted, vertical < high * LINE, horizontal < wide * LINE, right < 0, down < 0)
    label = _labels([tag for tag, _ in kinds], has_text, steps, horizontal - wide, vertical - high, down)
    return Structure(
        relations=tree + _SCREEN[_code(bits)],
        label=label,
        labelled=np.flatnonzero(label != NONE),
        group=group,
        own_group=np.where(group == NONE, np.arange(len(kinds)), group),
        kinds=kinds,
        rank=rank,
        alike=alike,
        leaf=leaf,
        height=box[:, 3],
        flags=_flags(box, leaf, rank, alike, label, group),
    )


def _code(bits: Sequence[NDArray[np.bool_]]) -> NDArray[np.uint8]:
    """Binary numbers, the most significant bit first."""
    code = bits[0].view(np.uint8)
    for bit in bits[1:]:
        code = code + code + bit.view(np.uint8)
    return code


def _ranks(
    kinds: Sequence[tuple[str, str]], parents: Sequence[int]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """The columns `group`, `rank` and `alike` of a structure."""
    siblings: dict[tuple[int, tuple[str, str]], int] = {}
    counts: dict[tuple[str, str], int] = {}
    rank: list[int] = []
    group: list[int] = []
    for at, kind in zip(parents, kinds, strict=True):
        siblings[at, kind] = siblings.get((at, kind), 0) + 1
        counts[kind] = counts.get(kind, 0) + 1
        rank.append(counts[kind])
    for at in parents:
        repeated = at >= 0 and siblings[parents[at], kinds[at]] > 1
        group.append(at if repeated else group[at] if at >= 0 else NONE)
    alike = [counts[kind] for kind in kinds]
    return np.array(group, dtype=np.int64), np.array(rank, dtype=np.int64), np.array(alike, dtype=np.int64)


def _flags(
    box: NDArray[np.float32],
    leaf: NDArray[np.bool_],
    rank: NDArray[np.int64],
    alike: NDArray[np.int64],
    label: NDArray[np.int64],
    group: NDArray[np.int64],
) -> NDArray[np.float32]:
    """[E, PAGE_FLAGS]"""
    flags = np.zeros((len(box), PAGE_FLAGS), dtype=np.float32)
    flags[:, POSITION] = box / _PAGE_PX
    flags[:, LEAF], flags[:, LABELLED], flags[:, GROUPED] = leaf, label != NONE, group != NONE
    flags[:, RANK] = rank[:, None] == _RANKS
    flags[:, RANK_LAST], flags[:, RANK_ONLY], flags[:, ALIKE_COUNT] = rank == alike, alike == 1, np.log(alike)
    largest = np.maximum(box[leaf, 2:].max(axis=0, initial=0.0), 1.0)
    flags[:, SIZE] = np.log(np.clip(box[:, 2:] / largest, 0.02, 4.0))
    return flags


@functools.lru_cache(maxsize=512)
def _tree(parents: bytes) -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.bool_]]:
    """[E, E] SCREEN_RELATIONS * relation, [E, E] number of steps between two elements in the tree, [E] leaves."""
    parent = np.frombuffer(parents, dtype=np.int16)
    common = np.zeros((len(parent), len(parent)), dtype=np.int64)  # number of ancestors, and itself, of both
    for row, at in enumerate(parent.tolist()):
        if at >= 0:
            common[row, :row] = common[:row, row] = common[at, :row]
        common[row, row] = 1 + (common[at, at] if at >= 0 else 0)
    depth = common.diagonal()
    steps = depth[:, None] + depth - 2 * common
    ancestor = common == depth
    leaf = np.ones(len(parent), dtype=np.bool_)
    leaf[parent[parent >= 0]] = False
    return _TREE[np.minimum(steps, 7) + 8 * ancestor + 16 * ancestor.T], steps, leaf


def _labels(
    tags: Sequence[str],
    has_text: Sequence[bool],
    steps: NDArray[np.int64],
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
