"""The features of a page that do not depend on the goal, cached: most steps of an episode change little of a page."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.language import Vectors
from giirl_core.nets.layout import (
    CHECKED,
    CLICKABLE,
    ELEMENT_IDS,
    ELEMENT_WORDS,
    HAS_NUMBER,
    HAS_TEXT,
    HAS_VALUE,
    IS_FIELD,
    KIND_NAMED,
    LEAST,
    MOST,
    NAMES_KIND,
    NUMBER,
    PAGE_FLAGS,
    TYPABLE,
    WORDS,
)
from giirl_core.nets.reading import SMALL_PX, Floats, Ids, Kind, Text, read_kind, unit_vectors, words_of_text
from giirl_core.nets.relations import Structure, structure_of
from giirl_core.types import TYPABLE_TAGS, Page

_TOGGLES = frozenset({"input_checkbox", "input_radio"})  # tags of fields whose value is no text


@dataclass(frozen=True, slots=True, kw_only=True)
class Element:
    """What an element says, whatever is around it."""

    alike: tuple[str, str]  # tag and classes
    text: Text
    value: Text | None  # None without a value
    attributes: Text | None  # None without attributes
    kind: Kind
    words: tuple[str, ...]  # the first WORDS words of text and value in lower case
    rows: tuple[int, ...]  # rows of their word vectors
    number: float  # the number that the text or value is, nan for none
    takes_label: bool  # it has no words of its own
    ids: Ids  # [ELEMENT_IDS]
    flags: Floats  # [PAGE_FLAGS] 0 where it depends on other elements


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFeatures:
    """What is read from a page of E elements. The arrays are shared: they must not be changed."""

    ids: Ids  # [E, ELEMENT_IDS]
    flags: Floats  # [E, PAGE_FLAGS] 0 where it depends on focus and earlier actions
    elements: Sequence[Element]  # [E]
    structure: Structure
    number: Floats  # [E] the number that the text or value is, nan for none
    drawings: dict[int, frozenset[str]]  # description of each drawing
    month: tuple[int | None, int] | None  # year and month, where the page shows one month
    rows: tuple[int, ...]  # [U] rows of the vectors of the words of the page
    units: Floats  # [U, D] their unit vectors
    unit: NDArray[np.int64]  # [W] rows of `units`: the words of each element, one element after the other
    with_words: NDArray[np.int64]  # [R] elements with at least one word
    first_unit: NDArray[np.int64]  # [R] index of the first word of each of these in `unit`


def page_features(page: Page, vectors: Vectors) -> PageFeatures:
    """The features of a page, from the cache if a page with the same content was read before."""
    columns = (page.tag, page.text, page.value, page.classes, page.attributes, page.colour, page.shape)
    parents, boxes = page.parent.astype(np.int16), page.box.astype(np.float32)
    return _page_features(columns, parents.tobytes(), boxes.tobytes(), vectors)


@functools.lru_cache(maxsize=1 << 10)
def _page_features(
    columns: tuple[tuple[str, ...], ...], parents: bytes, boxes: bytes, vectors: Vectors
) -> PageFeatures:
    elements = [_element(*strings, vectors) for strings in zip(*columns, strict=True)]
    structure = structure_of(columns[0], columns[3], [text != "" for text in columns[1]], parents, boxes)
    ids = _stack([element.ids for element in elements], ELEMENT_IDS, np.int32)
    ids[:, CLICKABLE] = structure.leaf
    flags = structure.flags + _stack([element.flags for element in elements], PAGE_FLAGS, np.float32)
    _mark_kinds(flags, elements)
    _mark_extremes(flags, elements)
    words = [element.rows for element in elements]
    for e in structure.labelled.tolist():
        if elements[e].takes_label:
            words[e] = elements[structure.label[e]].text.rows
            ids[e, ELEMENT_WORDS][: len(words[e])] = words[e]
    counts = np.array([len(rows) for rows in words], dtype=np.int64)
    with_words = np.flatnonzero(counts)
    unit: dict[int, int] = {}
    places = np.array([unit.setdefault(row, len(unit)) for rows in words for row in rows], dtype=np.int64)
    return PageFeatures(
        ids=ids,
        flags=flags,
        elements=elements,
        structure=structure,
        number=np.array([element.number for element in elements], dtype=np.float32),
        drawings=_drawings(elements, structure),
        month=_month(elements),
        unit=places,
        rows=tuple(unit),
        units=unit_vectors(unit, vectors),
        with_words=with_words,
        first_unit=(counts.cumsum() - counts)[with_words],
    )


@functools.lru_cache(maxsize=1 << 14)
def _element(
    tag: str, text: str, value: str, classes: str, attributes: str, colour: str, shape: str, vectors: Vectors
) -> Element:
    own, entered = words_of_text(text, vectors), words_of_text(value, vectors) if value else None
    kind = read_kind(tag, classes, attributes, colour, shape, text if tag == "text" else "", vectors)
    words, rows, number = own.folded, own.rows, own.number
    if entered is not None:
        words, rows = words + entered.folded, rows + entered.rows
        number = entered.number if math.isnan(number) else number
    ids, flags = kind.ids.copy(), np.zeros(PAGE_FLAGS, dtype=np.float32)
    ids[ELEMENT_WORDS][: len(rows)] = rows[:WORDS]
    ids[TYPABLE] = flags[IS_FIELD] = tag in TYPABLE_TAGS
    flags[HAS_TEXT], flags[HAS_VALUE] = len(own.exact) > 0, entered is not None and len(entered.exact) > 0
    flags[CHECKED] = value == "checked"
    if not math.isnan(number):
        flags[HAS_NUMBER], flags[NUMBER] = 1.0, min(max(number, -20), 40) / 10
    return Element(
        alike=(tag, classes),
        text=own,
        value=entered,
        attributes=words_of_text(attributes, vectors) if attributes else None,
        kind=kind,
        words=words[:WORDS],
        rows=rows[:WORDS],
        number=number,
        takes_label=not own.exact and (entered is None or tag in _TOGGLES),
        ids=ids,
        flags=flags,
    )


def _stack(rows: Sequence[NDArray[Any]], width: int, dtype: type) -> NDArray[Any]:
    """[len(rows), width]; faster than np.stack."""
    return np.concatenate(rows).reshape(-1, width) if rows else np.zeros((0, width), dtype=dtype)


def _mark_kinds(flags: Floats, elements: Sequence[Element]) -> None:
    """Set NAMES_KIND and KIND_NAMED: the only word of an element is a word for the tag or shape of another one."""
    singles: dict[str, list[int]] = {}
    for e, element in enumerate(elements):
        if len(element.words) == 1:
            singles.setdefault(element.words[0], []).append(e)
    for e, element in enumerate(elements):
        for word in element.kind.tag_words:
            for other in singles.get(word, ()):
                if other != e:
                    flags[other, NAMES_KIND] = flags[e, KIND_NAMED] = 1.0


def _mark_extremes(flags: Floats, elements: Sequence[Element]) -> None:
    """Set LEAST and MOST, for elements with the same tag and classes and equally many numbers."""
    groups: dict[tuple[str, str], list[int]] = {}
    for e, element in enumerate(elements):
        if element.text.numbers:
            groups.setdefault(element.alike, []).append(e)
    for rows in groups.values():
        numbers = [elements[e].text.numbers for e in rows]
        least, most = min(numbers), max(numbers)
        if least < most and len({len(some) for some in numbers}) == 1:
            for e, some in zip(rows, numbers, strict=True):
                flags[e, LEAST], flags[e, MOST] = some == least, some == most


def _drawings(elements: Sequence[Element], structure: Structure) -> dict[int, frozenset[str]]:
    """The description of each drawing: its size, colour and shape."""
    found = {e: element.kind.drawing for e, element in enumerate(elements) if element.kind.drawing is not None}
    return {e: words | {"small" if structure.height[e] < SMALL_PX else "large"} for e, words in found.items()}


def _month(elements: Sequence[Element]) -> tuple[int | None, int] | None:
    """The year (None if the page shows none) and month of a calendar; None if the page does not show one month."""
    months = [element.text.month for element in elements if element.text.month]
    years = [element.text.year for element in elements if element.text.year]
    return (years[0] if years else None, months[0]) if len(months) == 1 else None
