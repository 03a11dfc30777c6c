"""A page under a goal as arrays: everything the nets see of it, built by vectorised code.

Strings are cut into words once and cached; what is left for each step is comparing arrays of word hashes.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.language import PADDING, Vectors
from giirl_core.nets.reading import (
    CLASS_SLOTS,
    CLASSES,
    COLOURS,
    GOAL_NUMBERS,
    KIND_WORDS,
    MONTHS,
    TAGS,
    TOKEN_FLAGS,
    WHAT_WORDS,
    WORDS,
    Floats,
    GoalText,
    Hashes,
    Ids,
    Text,
    described_as,
    read_goal,
    read_kind,
    read_text,
    runs,
    units_of,
)
from giirl_core.nets.relations import NONE, RELATIONS, structure_of
from giirl_core.types import Goal, Page

__all__ = ["CLASSES", "RELATIONS", "TAGS", "TOKEN_FLAGS", "WORDS", "Features", "featurise"]

WIDTH_PX, HEIGHT_PX = 160.0, 210.0
OFF = frozenset(os.environ.get("READER_OFF", "").split(","))  # trials: what is switched off

# Columns of Features.element_ids.
ELEMENT_WORDS = slice(0, WORDS)
ELEMENT_KIND = slice(WORDS, WORDS + KIND_WORDS)
TAG = WORDS + KIND_WORDS
CLASS = slice(TAG + 1, TAG + 1 + CLASS_SLOTS)
CLICKABLE, TYPABLE = TAG + 1 + CLASS_SLOTS, TAG + 2 + CLASS_SLOTS
ELEMENT_IDS = TAG + 3 + CLASS_SLOTS
# Kinds of match between an element and the goal.
TEXT_RUN, TEXT_WORD, VALUE_RUN, KIND_WORD, ATTRIBUTE_RUN, LABEL_RUN, LABEL_WORD, GROUP_RUN, SIMILAR, LIKEST = range(10)
MATCH_KINDS = 10
LEAST_ALIKE = 0.25  # cosine of the word on the page that is most like a word of the goal, to count
ALIKE = 0.5  # cosine of words that count as similar
# Columns of Features.element_flags: the box as shares of a page, state, then agreement of element and goal.
POSITION = slice(0, 4)
STATE = 4  # focused, tampered, leaf, typable, text, value, checked
COLOUR = 11  # red, green, blue, any
RANK = 15  # 1st .. 5th, last, only, count
SIZE = 23  # logarithms of width and height against the largest
SAID = 25  # its words are another element's kind; a kind of it is another's text
DONE = 27  # how many elements were acted on
ELEMENT_OVERLAP = slice(28, 28 + 2 * MATCH_KINDS + 10)  # each kind, each kind in quotes; then others
FOLDED, SHARE, PREFIX, LIKENESS, BEST, LABEL_LIKENESS, GROUPED, RANK_IS_NUMBER, LABELLED, SUFFIX = (
    28 + 2 * MATCH_KINDS + i for i in range(10)
)
NUMBERS = ELEMENT_OVERLAP.stop  # any, its size; then for each number of the goal: PER_NUMBER of
EQUAL, SIGN, DISTANCE, CYCLIC, DONE_EQUAL, DONE_SIGN, WANTED, PER_NUMBER = range(8)
LEAST, MOST = NUMBERS + 2 + PER_NUMBER * GOAL_NUMBERS, NUMBERS + 3 + PER_NUMBER * GOAL_NUMBERS
CALENDAR = (
    NUMBERS + 4 + PER_NUMBER * GOAL_NUMBERS
)  # the page shows a month; it is the goal's; goal's is later, or earlier
FITS = NUMBERS + 8 + PER_NUMBER * GOAL_NUMBERS  # a drawing is as described; so many are as the element's number says
PEER = (
    NUMBERS + 10 + PER_NUMBER * GOAL_NUMBERS
)  # agrees with the goal as what was acted on, and was not; the page has one
ELEMENT_FLAGS = NUMBERS + 12 + PER_NUMBER * GOAL_NUMBERS
# Columns of Features.token_ids and Features.token_flags.
WORD, OPEN, TOKEN_IDS = 0, 1, 2
TOKEN_OVERLAP = slice(3, 11)  # 5 is whether it is quoted


@dataclass(frozen=True, slots=True, kw_only=True)
class Features:
    """One page under one goal: L goal tokens, E elements, K matches between them."""

    token_ids: Ids  # [L, TOKEN_IDS] row of the word vectors; whether the page gives the word its meaning
    token_flags: Floats  # [L, TOKEN_FLAGS]
    element_ids: Ids  # [E, ELEMENT_IDS] rows of the word vectors, tag, classes, clickable, typable
    element_flags: Floats  # [E, ELEMENT_FLAGS]
    group: NDArray[
        np.int64
    ]  # [E] row of the ancestor that repeats, as a row of a table does; the element's own if none
    relations: NDArray[np.uint8]  # [E, E] what each column is to a row
    match_ids: Ids  # [K, 3] element, kind, token: where the goal says the same as an element
    match_weights: Floats  # [K] sum to 1 over the tokens of one element and kind


def featurise(page: Page, goal: Goal, vectors: Vectors) -> Features:
    """Arrays for one page under one goal. Overlap is exact in case and spelling unless it says `folded`."""
    words, count = read_goal(goal, vectors), len(page)
    texts = [read_text(text, vectors) for text in page.text]
    values = {e: read_text(value, vectors) for e, value in enumerate(page.value) if value}
    structure = structure_of(page)
    ids, folded, kinds, what = _ids(page, texts, values, vectors)
    if "labelwords" not in OFF:
        for e in np.flatnonzero(structure.label != NONE).tolist():
            if not texts[e].exact and not (
                e in values and page.tag[e] != "input_checkbox" and page.tag[e] != "input_radio"
            ):
                ids[e, ELEMENT_WORDS] = texts[structure.label[e]].rows
    leaf, typable = page.leaf, page.typable
    ids[:, CLICKABLE], ids[:, TYPABLE] = leaf, typable
    flags = np.zeros((count, ELEMENT_FLAGS), dtype=np.float32)
    flags[:, POSITION] = page.box / (WIDTH_PX, HEIGHT_PX, WIDTH_PX, HEIGHT_PX)
    flags[:, STATE], flags[:, STATE + 1], flags[:, STATE + 2], flags[:, STATE + 3] = (
        page.focused,
        page.tampered,
        leaf,
        typable,
    )
    flags[:, STATE + 4] = [len(text.exact) > 0 for text in texts]
    for e, value in values.items():
        flags[e, STATE + 5], flags[e, STATE + 6] = len(value.exact) > 0, page.value[e] == "checked"
    if count:
        _ranks(flags, structure.rank, structure.alike, words)
        largest = np.maximum(page.box[leaf, 2:].max(axis=0), 1.0) if leaf.any() else np.ones(2)
        flags[:, SIZE : SIZE + 2] = np.log(np.clip(page.box[:, 2:] / largest, 0.02, 4.0))
        _numbers(flags, page, texts, values, words, structure.rank, structure.alike)
        _said(flags, folded, what)
        _extremes(flags, page, texts)
        _calendar(flags, page, words)
        _drawings(flags, page, texts, words)
    matches, likeness = _matches(
        page, texts, values, words, ids, folded, kinds, structure.label, structure.group, flags, vectors
    )
    flags[:, 28 : 28 + MATCH_KINDS] = matches.any(axis=2)
    flags[:, 28 + MATCH_KINDS : 28 + 2 * MATCH_KINDS] = (matches & words.quoted).any(axis=2)
    _peers(flags, page, matches, leaf)
    token_flags, on_page = words.flags.copy(), matches[:, TEXT_WORD].any(axis=0)
    token_flags[:, 3], token_flags[:, 4] = on_page, matches[:, VALUE_RUN].any(axis=0)
    token_flags[:, 6:11] = matches[:, [TEXT_RUN, KIND_WORD, LABEL_WORD, GROUP_RUN, SIMILAR]].any(axis=0).T
    elements, kind, tokens = np.nonzero(matches)
    weight = 1.0 / matches.sum(axis=2)[elements, kind]
    del likeness
    return Features(
        token_ids=np.stack(
            [words.rows, words.quoted | on_page | matches[:, LIKEST].any(axis=0)], axis=1, dtype=np.int32
        ),
        token_flags=token_flags,
        element_ids=ids,
        element_flags=flags,
        group=np.where(structure.group == NONE, np.arange(count), structure.group),
        relations=structure.relations,
        match_ids=np.stack([elements, kind, tokens], axis=1).astype(np.int32),
        match_weights=weight.astype(np.float32),
    )


def _ids(
    page: Page, texts: list[Text], values: dict[int, Text], vectors: Vectors
) -> tuple[Ids, Hashes, Hashes, Hashes]:
    """Columns of ids, then the hashes of the words read [E, WORDS], of those for its kind [E, KIND_WORDS] and tag."""
    count = len(page)
    ids = np.zeros((count, ELEMENT_IDS), dtype=np.int32)
    folded, named = np.zeros((count, WORDS), dtype=np.int64), np.zeros((count, KIND_WORDS), dtype=np.int64)
    if not count:
        return ids, folded, named, named
    columns = zip(page.tag, page.classes, page.attributes, page.colour, page.shape, page.text, strict=True)
    kinds = [
        read_kind(tag, classes, attributes, colour, shape, text if tag == "text" else "", vectors)
        for tag, classes, attributes, colour, shape, text in columns
    ]
    ids[:, ELEMENT_WORDS] = np.concatenate([text.rows for text in texts]).reshape(count, WORDS)
    folded = np.concatenate([text.read for text in texts]).reshape(count, WORDS)
    ids[:, ELEMENT_KIND] = np.concatenate([kind.rows for kind in kinds]).reshape(count, KIND_WORDS)
    named = np.concatenate([kind.hashes for kind in kinds]).reshape(count, KIND_WORDS)
    ids[:, TAG] = [kind.tag for kind in kinds]
    ids[:, CLASS] = [kind.classes for kind in kinds]
    for e, value in values.items():
        used = min(len(texts[e].exact), WORDS)
        ids[e, used:WORDS], folded[e, used:] = value.rows[: WORDS - used], value.read[: WORDS - used]
    return ids, folded, named, np.concatenate([kind.what for kind in kinds]).reshape(count, WHAT_WORDS)


def _ranks(flags: Floats, rank: NDArray[np.int64], alike: NDArray[np.int64], words: GoalText) -> None:
    if "rank" in OFF:
        return
    for nth in range(1, 6):
        flags[:, RANK + nth - 1] = rank == nth
    flags[:, RANK + 5], flags[:, RANK + 6] = rank == alike, alike == 1
    flags[:, RANK + 7] = np.log(alike)
    flags[:, RANK_IS_NUMBER] = (rank[:, None] == words.numbers).any(axis=1)


def _numbers(
    flags: Floats,
    page: Page,
    texts: list[Text],
    values: dict[int, Text],
    words: GoalText,
    rank: NDArray[np.int64],
    alike: NDArray[np.int64],
) -> None:
    if "number" in OFF:
        return
    number = np.array([text.number for text in texts], dtype=np.float32)
    for e, value in values.items():
        if np.isnan(number[e]):
            number[e] = value.number
    found = np.flatnonzero(~np.isnan(number))
    flags[found, NUMBERS], flags[found, NUMBERS + 1] = 1.0, np.clip(number[found], -20, 40) / 10
    done = int((page.tampered & page.leaf).sum())
    flags[:, DONE] = np.log1p(done)
    for n, wanted in enumerate(words.numbers.tolist()):
        at = NUMBERS + 2 + PER_NUMBER * n
        if np.isnan(wanted):
            continue
        difference = wanted - number[found]
        flags[found, at + EQUAL] = difference == 0
        flags[found, at + SIGN] = np.sign(difference)
        flags[found, at + DISTANCE] = np.sign(difference) * np.log1p(np.abs(difference)) / 4
        flags[:, at + CYCLIC] = (wanted - rank) % alike == 0
        flags[:, at + DONE_EQUAL], flags[:, at + DONE_SIGN] = done == wanted, np.sign(wanted - done)
        flags[:, at + WANTED] = min(max(wanted, -20), 40) / 10


def _peers(flags: Floats, page: Page, matches: NDArray[np.bool_], leaf: NDArray[np.bool_]) -> None:
    """Marks what looks like an element acted on before, and repeats the same words of the goal, but was not acted on."""
    done = np.flatnonzero(page.tampered & leaf)
    if not len(done) or "peers" in OFF:
        return
    said = matches[:, [TEXT_RUN, KIND_WORD, LABEL_RUN, GROUP_RUN]].any(axis=1)

    def signature(e: int) -> tuple[str, str, bytes]:
        return page.tag[e], page.classes[e].split(" ", 1)[0], said[e].tobytes()

    wanted = {signature(e) for e in done.tolist() if said[e].any()}
    peers = [e for e in np.flatnonzero(leaf & ~page.tampered).tolist() if signature(e) in wanted]
    flags[peers, PEER] = 1.0
    flags[:, PEER + 1] = len(peers) > 0


def _calendar(flags: Floats, page: Page, words: GoalText) -> None:
    """Marks all elements where the page shows a month and the goal has a date: whether to go on or back."""
    if words.month is None:
        return
    months = [MONTHS.index(text.lower()) + 1 for text in page.text if text.lower() in MONTHS]
    years = [int(text) for text in page.text if len(text) == 4 and text.isdigit()]
    if len(months) == 1:
        shown = (years[0] if years else words.month[0], months[0])
        flags[:, CALENDAR] = 1.0
        flags[:, CALENDAR + 1] = shown == words.month
        flags[:, CALENDAR + 2], flags[:, CALENDAR + 3] = words.month > shown, words.month < shown


def _drawings(flags: Floats, page: Page, texts: list[Text], words: GoalText) -> None:
    """Marks drawings that are as the goal describes them, and elements that say how many. Unknown colours mark none."""
    if (words.described is None and not words.signs) or "drawings" in OFF:
        return
    wanted = words.described or frozenset()
    columns = zip(page.tag, page.colour, page.shape, page.text, page.box[:, 3].tolist(), strict=True)
    drawn = {
        e: (described_as(tag, colour, shape, text, height), text)
        for e, (tag, colour, shape, text, height) in enumerate(columns)
        if tag == "text" or shape
    }
    if not drawn or (wanted & COLOURS and not any(page.colour[e] for e in drawn)):
        return
    fits = [e for e, (found, text) in drawn.items() if wanted <= found and (not words.signs or text in words.signs)]
    flags[fits, FITS] = 1.0
    for e, text in enumerate(texts):
        flags[e, FITS + 1] = e not in drawn and text.number == len(fits)


def _extremes(flags: Floats, page: Page, texts: list[Text]) -> None:
    """Marks the least and the greatest of elements that look alike and hold numbers."""
    alike: dict[tuple[str, str], list[int]] = {}
    for e, text in enumerate(texts):
        if text.numbers:
            alike.setdefault((page.tag[e], page.classes[e]), []).append(e)
    for rows in alike.values():
        held = [texts[e].numbers for e in rows]
        least, most = min(held), max(held)
        if least < most and len({len(numbers) for numbers in held}) == 1:
            for e, numbers in zip(rows, held, strict=True):
                flags[e, LEAST], flags[e, MOST] = numbers == least, numbers == most


def _said(flags: Floats, folded: Hashes, kinds: Hashes) -> None:
    """Marks elements whose one word another element is of a kind with, and those others."""
    if "said" in OFF:
        return
    single = np.where(folded[:, 1] == 0, folded[:, 0], 0)
    same = (kinds[:, :, None] == single) & (single != 0)  # [E, KIND_WORDS, E]
    same = same.any(axis=1)
    np.fill_diagonal(same, False)
    flags[:, SAID], flags[:, SAID + 1] = same.any(axis=0), same.any(axis=1)


def _matches(
    page: Page,
    texts: list[Text],
    values: dict[int, Text],
    words: GoalText,
    ids: Ids,
    folded: Hashes,
    kinds: Hashes,
    label: NDArray[np.int64],
    group: NDArray[np.int64],
    flags: Floats,
    vectors: Vectors,
) -> tuple[NDArray[np.bool_], Floats]:
    """[E, MATCH_KINDS, L] where the goal repeats an element; flags of how well it does are set on the way."""
    count, length = len(page), len(words.exact)
    matches = np.zeros((count, MATCH_KINDS, length), dtype=np.bool_)
    likeness = np.zeros((count, length), dtype=np.float32)
    if not count:
        return matches, likeness
    matches[:, TEXT_WORD] = (folded[:, :, None] == words.hashes).any(axis=1)
    if "kind" not in OFF:
        matches[:, KIND_WORD] = (kinds[:, :, None] == words.hashes).any(axis=1)
    for e in np.flatnonzero(matches[:, TEXT_WORD].any(axis=1)).tolist():
        exact = texts[e].exact
        for start in runs(words.exact, exact):
            matches[e, TEXT_RUN, start : start + len(exact)] = True
        flags[e, FOLDED] = len(runs(words.folded, texts[e].folded)) > 0
        flags[e, SHARE] = matches[e, TEXT_WORD, words.first].sum() / len({*folded[e].tolist()} - {0})
    for e, value in values.items():
        for start in runs(words.exact, value.exact):
            matches[e, VALUE_RUN, start : start + len(value.exact)] = True
    for e, attributes in enumerate(page.attributes):
        if attributes and "attribute" not in OFF:
            exact = read_text(attributes, vectors).exact
            for start in runs(words.exact, exact):
                matches[e, ATTRIBUTE_RUN, start : start + len(exact)] = True
    if words.prefixes:
        for e, text in enumerate(texts):
            first = text.folded[0] if text.folded else ""
            last = text.folded[-1] if text.folded else ""
            if first:
                flags[e, PREFIX] = any(first.startswith(prefix) for prefix in words.prefixes)
                flags[e, SUFFIX] = last.endswith(words.prefixes[-1])
    if "similar" not in OFF:
        likeness = _likeness(ids, words, vectors)
        best = likeness.max(axis=1)
        flags[:, LIKENESS] = best
        # A word of the goal may be said in other words where nothing on the page repeats it.
        unsaid = ~matches[:, TEXT_WORD].any(axis=0)
        top = likeness.max(axis=0)
        open_words = likeness * unsaid
        mutual = (open_words == open_words.max(axis=1, keepdims=True)) & (likeness == top)
        matches[:, LIKEST] = mutual & (top > LEAST_ALIKE) & unsaid
        matches[:, SIMILAR] = (likeness >= ALIKE) & unsaid & ~matches[:, TEXT_WORD]
    named = np.flatnonzero(label != NONE)
    if len(named) and "label" not in OFF:
        by = label[named]
        matches[named, LABEL_RUN], matches[named, LABEL_WORD] = matches[by, TEXT_RUN], matches[by, TEXT_WORD]
        matches[named, SIMILAR] |= matches[by, SIMILAR]
        flags[named, LABEL_LIKENESS] = flags[by, LIKENESS]
        matches[named, LIKEST] |= matches[by, LIKEST]
        flags[named, LABELLED] = 1.0
    if "group" not in OFF:
        grouped = np.flatnonzero(group != NONE)
        if len(grouped):
            said = np.zeros((count, length), dtype=np.bool_)
            np.logical_or.at(said, group[grouped], matches[grouped, TEXT_RUN])
            matches[grouped, GROUP_RUN] = said[group[grouped]] & ~matches[grouped, TEXT_RUN]
            flags[grouped, GROUPED] = 1.0
    return matches, likeness


def _likeness(ids: Ids, words: GoalText, vectors: Vectors) -> Floats:
    """[E, L] the largest cosine of a word of the element with each word of the goal, at least 0."""
    rows = ids[:, ELEMENT_WORDS]
    unique, place = np.unique(rows, return_inverse=True)
    cosine = units_of(unique, vectors) @ words.units.T
    cosine[unique == PADDING] = 0.0
    out: Floats = np.maximum(cosine[place.reshape(rows.shape)].max(axis=1), 0.0)
    return out
