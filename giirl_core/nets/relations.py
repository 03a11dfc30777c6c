"""How the elements of a page stand to each other: in the tree, on the screen, and as labels and rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import Page

TREE = 11  # kinds of relation in the tree
SCREEN = 6  # kinds of relation on the screen
RELATIONS = TREE * SCREEN
NONE = -1
FIELD_TAGS = ("input_", "textarea", "select")
LABEL_DISTANCE = 5  # steps through the tree from a field to its label at most
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
    above = np.zeros((count, count), dtype=np.float32)
    siblings: dict[tuple[int, tuple[str, str]], int] = {}
    seen: dict[tuple[str, str], int] = {}
    rank = np.zeros(count, dtype=np.int64)
    for row, at in enumerate(parent.tolist()):
        if at >= 0:
            above[row] = above[at]
        above[row, row] = 1.0
        key = (at, looks[row])
        siblings[key] = siblings.get(key, 0) + 1
        rank[row] = seen[looks[row]] = seen.get(looks[row], 0) + 1
    group = np.full(count, NONE, dtype=np.int64)
    for row, at in enumerate(parent.tolist()):
        if at >= 0:
            group[row] = at if siblings[(int(parent[at]), looks[at])] > 1 else group[at]
    shared = above @ above.T  # ancestors in common, themselves included
    depth = np.diagonal(shared)
    distance = depth[:, None] + depth[None, :] - 2 * shared
    tree = np.clip(distance, 2, 7).astype(np.int64) + 3  # 5 .. 10
    up, down = shared == depth[None, :], shared == depth[:, None]
    tree[up] = np.where(distance[up] == 1, 1, 2)
    tree[down] = np.where(distance[down] == 1, 3, 4)
    np.fill_diagonal(tree, 0)
    box = page.box.astype(np.float32)
    size = box[:, 2:]
    offset = (box[:, :2] + size / 2)[None] - (box[:, :2] + size / 2)[:, None]  # from row to column
    touch = (size[None] + size[:, None]) / 2
    gap = np.abs(offset) - touch
    level, upright = np.abs(offset[..., 1]) < touch[..., 1] * 0.6, np.abs(offset[..., 0]) < touch[..., 0] * 0.6
    screen = np.where(
        level & upright,
        0,
        np.where(level, np.where(offset[..., 0] < 0, 1, 2), np.where(upright, np.where(offset[..., 1] < 0, 3, 4), 5)),
    )
    return Structure(
        relations=(tree * SCREEN + screen).astype(np.uint8),
        label=_labels(page, distance, offset, gap),
        group=group,
        rank=rank,
        alike=np.array([seen[look] for look in looks], dtype=np.int64),
    )


def _labels(
    page: Page, distance: NDArray[np.float32], offset: NDArray[np.float32], gap: NDArray[np.float32]
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
        pixels = np.maximum(gap[row, texts, 0], 0) + DOWN * np.maximum(gap[row, texts, 1], 0)
        after = (offset[row, texts, 1] > 4.0) * 50.0  # a label stands before its field, or beside it
        cost = near * 1000.0 + pixels + after
        best = int(cost.argmin())
        if near[best] <= LABEL_DISTANCE:
            label[row] = texts[best]
    return label
