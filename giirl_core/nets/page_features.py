"""The features of a page that do not depend on the goal, cached: most steps of an episode change little of a page."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.language import PADDING, Vectors
from giirl_core.nets.layout import (
    ALIKE_COUNT,
    CHECKED,
    CLASS,
    CLICKABLE,
    ELEMENT_IDS,
    ELEMENT_KIND,
    ELEMENT_WORDS,
    GROUPED,
    HAS_NUMBER,
    HAS_TEXT,
    HAS_VALUE,
    HEIGHT_PX,
    IS_FIELD,
    KIND_NAMED,
    KIND_WORDS,
    LABELLED,
    LEAF,
    LEAST,
    MOST,
    NAMES_KIND,
    NUMBER,
    PAGE_FLAGS,
    POSITION,
    RANK,
    RANK_LAST,
    RANK_ONLY,
    SIZE,
    TAG,
    TYPABLE,
    WIDTH_PX,
    WORDS,
)
from giirl_core.nets.reading import (
    MONTHS,
    TAG_WORDS,
    Floats,
    Hashes,
    Ids,
    Kind,
    Text,
    description,
    read_kind,
    read_text,
    unit_vectors,
)
from giirl_core.nets.relations import NONE, Structure, structure_of
from giirl_core.types import Page

_TOGGLES = frozenset({"input_checkbox", "input_radio"})  # tags of fields whose value is no text


@dataclass(frozen=True, slots=True)
class Words:
    """Words of elements, one element after the other. Only the elements in `rows` have any."""

    rows: NDArray[np.int64]  # [R] elements with at least one word
    starts: NDArray[np.int64]  # [R] index of the first word of each
    words: NDArray[np.int64]  # [W] hashes, or rows of the table of unit vectors

    @classmethod
    def of(cls, table: NDArray[np.int64]) -> Words:
        """From a table [E, W] with 0 after the last word of each element."""
        found = table != 0
        counts = found.sum(axis=1)
        rows = np.flatnonzero(counts)
        return cls(rows, np.cumsum(counts[rows]) - counts[rows], table[found])


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFeatures:
    """What is read from a page of E elements. The arrays are shared: they must not be changed."""

    ids: Ids  # [E, ELEMENT_IDS]
    flags: Floats  # [E, PAGE_FLAGS] 0 where it depends on focus and earlier actions
    texts: Sequence[Text]  # [E]
    values: dict[int, Text]  # of the elements with a value
    attributes: dict[int, Text]  # of the elements with attributes
    structure: Structure
    hashes: Words  # of the words of elements, in lower case
    kinds: Words  # of the words for their kinds
    word_hashes: Hashes  # [E, WORDS] the same as a table, 0 after the last word
    vectors: Words  # rows of `units` of the words of elements; the words of its label for a field without text
    units: Floats  # [U, D] unit vectors of all words of the page
    number: Floats  # [E] the number that the text or value is, nan for none
    ends: Sequence[tuple[int, str, str]]  # element, first and last word of its text, in lower case
    drawings: dict[int, frozenset[str]]  # description of each drawing
    month: tuple[int | None, int] | None  # year and month, where the page shows one month


def page_features(page: Page, vectors: Vectors) -> PageFeatures:
    """The features of a page, from the cache if a page with the same content was read before."""
    texts = (page.tag, page.text, page.value, page.classes, page.attributes, page.colour, page.shape)
    return _page_features(texts, page.parent.astype(np.int16).tobytes(), page.box.astype(np.float32).tobytes(), vectors)


@functools.lru_cache(maxsize=1 << 10)
def _page_features(
    columns: tuple[tuple[str, ...], ...], parents: bytes, boxes: bytes, vectors: Vectors
) -> PageFeatures:
    tag, text, value, classes, attributes, colour, shape = columns
    count = len(tag)
    page = Page(
        tag=tag,
        text=text,
        value=value,
        classes=classes,
        attributes=attributes,
        colour=colour,
        shape=shape,
        ref=np.zeros(count, dtype=np.int32),
        parent=np.frombuffer(parents, dtype=np.int16),
        box=np.frombuffer(boxes, dtype=np.float32).reshape(count, 4),
        focused=np.zeros(count, dtype=np.bool_),
        tampered=np.zeros(count, dtype=np.bool_),
    )
    texts = [read_text(part, vectors) for part in text]
    values = {e: read_text(part, vectors) for e, part in enumerate(value) if part}
    drawn = [part if name == "text" else "" for name, part in zip(tag, text, strict=True)]
    names = zip(tag, classes, attributes, colour, shape, drawn, strict=True)
    kinds = [read_kind(*name, vectors) for name in names]
    structure = structure_of(page)
    hashes, word_rows = _words(texts, values)
    kind_hashes = _stack([kind.hashes for kind in kinds], KIND_WORDS)
    number = np.array([part.number for part in texts], dtype=np.float32)
    for e, part in values.items():
        number[e] = part.number if np.isnan(number[e]) else number[e]
    for e in np.flatnonzero(structure.label != NONE).tolist():
        if not texts[e].exact and (e not in values or tag[e] in _TOGGLES):
            word_rows[e] = texts[structure.label[e]].rows
    ids = np.zeros((count, ELEMENT_IDS), dtype=np.int32)
    ids[:, ELEMENT_WORDS] = word_rows
    if count:
        ids[:, ELEMENT_KIND] = np.concatenate([kind.rows for kind in kinds]).reshape(count, KIND_WORDS)
        ids[:, TAG] = [kind.tag for kind in kinds]
        ids[:, CLASS] = [kind.classes for kind in kinds]
    ids[:, CLICKABLE], ids[:, TYPABLE] = page.leaf, page.typable
    unique, index = np.unique(word_rows, return_inverse=True)  # the first one is PADDING, if any
    index = index.reshape(word_rows.shape) + (0 if PADDING in unique[:1] else 1)
    units = np.concatenate([np.zeros((1, vectors.table.shape[1]), np.float32), unit_vectors(unique, vectors)])
    return PageFeatures(
        ids=ids,
        flags=_flags(page, texts, values, kinds, structure, hashes, number),
        texts=texts,
        values=values,
        attributes={e: read_text(part, vectors) for e, part in enumerate(attributes) if part},
        structure=structure,
        hashes=Words.of(hashes),
        kinds=Words.of(kind_hashes),
        word_hashes=hashes,
        vectors=Words.of(index),
        units=units[1:] if PADDING in unique[:1] else units,
        number=number,
        ends=[(e, part.folded[0], part.folded[-1]) for e, part in enumerate(texts) if part.folded],
        drawings=_drawings(page),
        month=_month(page),
    )


def _stack(parts: Sequence[NDArray[np.int64]], width: int) -> NDArray[np.int64]:
    """[len(parts), width]; faster than np.stack."""
    return np.concatenate(parts).reshape(-1, width) if parts else np.zeros((0, width), dtype=np.int64)


def _words(texts: Sequence[Text], values: dict[int, Text]) -> tuple[Hashes, Ids]:
    """[E, WORDS] hashes, and rows of the word vectors, of the words of each element: its text, then its value."""
    hashes = _stack([text.hashes for text in texts], WORDS)
    rows = np.concatenate([np.zeros(0, dtype=np.int32), *(text.rows for text in texts)]).reshape(-1, WORDS)
    for e, value in values.items():
        used = min(len(texts[e].exact), WORDS)
        hashes[e, used:], rows[e, used:] = value.hashes[: WORDS - used], value.rows[: WORDS - used]
    return hashes, rows


def _flags(
    page: Page,
    texts: Sequence[Text],
    values: dict[int, Text],
    kinds: Sequence[Kind],
    structure: Structure,
    hashes: Hashes,
    number: Floats,
) -> Floats:
    """[E, PAGE_FLAGS]"""
    flags = np.zeros((len(page), PAGE_FLAGS), dtype=np.float32)
    if not len(page):
        return flags
    leaf, rank, alike = page.leaf, structure.rank, structure.alike
    flags[:, POSITION] = page.box / (WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX)
    flags[:, LEAF], flags[:, IS_FIELD] = leaf, page.typable
    flags[:, HAS_TEXT] = [len(text.exact) > 0 for text in texts]
    for e, value in values.items():
        flags[e, HAS_VALUE], flags[e, CHECKED] = len(value.exact) > 0, page.value[e] == "checked"
    flags[:, RANK] = rank[:, None] == np.arange(1, RANK.stop - RANK.start + 1)
    flags[:, RANK_LAST], flags[:, RANK_ONLY], flags[:, ALIKE_COUNT] = rank == alike, alike == 1, np.log(alike)
    largest = np.maximum(page.box[leaf, 2:].max(axis=0), 1.0) if leaf.any() else np.ones(2)
    flags[:, SIZE] = np.log(np.clip(page.box[:, 2:] / largest, 0.02, 4.0))
    flags[:, HAS_NUMBER] = ~np.isnan(number)
    flags[:, NUMBER] = np.clip(np.nan_to_num(number), -20, 40) / 10
    flags[:, LABELLED], flags[:, GROUPED] = structure.label != NONE, structure.group != NONE
    _mark_kinds(flags, hashes, _stack([kind.tag_hashes for kind in kinds], TAG_WORDS))
    _mark_extremes(flags, page, texts)
    return flags


def _mark_kinds(flags: Floats, hashes: Hashes, tag_hashes: Hashes) -> None:
    """Set NAMES_KIND and KIND_NAMED: the only word of an element is a word for the tag or shape of another one."""
    single = np.where(hashes[:, 1] == 0, hashes[:, 0], 0)
    named = ((tag_hashes[:, :, None] == single) & (single != 0)).any(axis=1)
    np.fill_diagonal(named, False)
    flags[:, NAMES_KIND], flags[:, KIND_NAMED] = named.any(axis=0), named.any(axis=1)


def _mark_extremes(flags: Floats, page: Page, texts: Sequence[Text]) -> None:
    """Set LEAST and MOST, for elements with the same tag and classes and equally many numbers."""
    groups: dict[tuple[str, str], list[int]] = {}
    for e, text in enumerate(texts):
        if text.numbers:
            groups.setdefault((page.tag[e], page.classes[e]), []).append(e)
    for rows in groups.values():
        numbers = [texts[e].numbers for e in rows]
        least, most = min(numbers), max(numbers)
        if least < most and len({len(some) for some in numbers}) == 1:
            for e, some in zip(rows, numbers, strict=True):
                flags[e, LEAST], flags[e, MOST] = some == least, some == most


def _drawings(page: Page) -> dict[int, frozenset[str]]:
    """The description of each drawing."""
    columns = zip(page.tag, page.colour, page.shape, page.text, page.box[:, 3].tolist(), strict=True)
    found = ((e, description(*column)) for e, column in enumerate(columns))
    return {e: words for e, words in found if words is not None}


def _month(page: Page) -> tuple[int | None, int] | None:
    """The year (None if the page shows none) and month of a calendar; None if the page does not show one month."""
    months = [MONTHS.index(text.lower()) + 1 for text in page.text if text.lower() in MONTHS]
    years = [int(text) for text in page.text if len(text) == 4 and text.isdigit()]
    return (years[0] if years else None, months[0]) if len(months) == 1 else None
