"""Words, numbers and descriptions in the texts of elements and in goals. Every string is read once and cached."""

from __future__ import annotations

import functools
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.colours import COLOURS, colour_names
from giirl_core.nets.language import FIRST_WORD, Vectors
from giirl_core.nets.layout import (
    CAPITAL,
    CLASS,
    CLASS_SLOTS,
    CLASSES,
    DIGIT,
    ELEMENT_IDS,
    ELEMENT_KIND,
    GOAL_NUMBERS,
    KIND_WORDS,
    PUNCTUATION,
    QUOTE,
    QUOTED,
    TAG,
    TAGS,
    TOKEN_FLAGS,
    WORDS,
)
from giirl_core.types import TOKEN, Goal

CENTRED_ROWS = 20_000  # the mean of this many word vectors is subtracted before two words are compared
COMMON_ROWS = 80  # words as frequent as these are similar to every word, so they are not compared
SMALL_PX = 15.0  # a drawing that is less high is small

Ids = NDArray[np.int32]
Floats = NDArray[np.float32]

_TAG_WORDS = {  # words that instructions use for elements with these tags
    "a": ("link",),
    "button": ("button",),
    "h1": ("header",),
    "h2": ("header",),
    "h3": ("header", "section"),
    "input_button": ("button",),
    "input_checkbox": ("checkbox",),
    "input_number": ("number", "field"),
    "input_password": ("password", "field"),
    "input_radio": ("radio",),
    "input_submit": ("button", "submit"),
    "input_text": ("text", "field"),
    "option": ("option",),
    "polygon": ("shape",),
    "circle": ("shape", "circle"),
    "rect": ("shape", "rectangle"),
    "select": ("list",),
    "textarea": ("textarea",),
}
_MONTHS = "january february march april may june july august september october november december"
MONTHS = tuple(_MONTHS.split())
_COUNTS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
_DRAWINGS = frozenset({"shape", "letter", "digit", "rectangle", "circle", "triangle", "item"})
_SIZES = frozenset({"small", "large"})
_NAME_PART = re.compile(r"[a-z]+|[A-Z][a-z]*|[^\W\d_]+")
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?![\d.]*\.\d)")
_INTEGER = re.compile(r"(?<!\d)\d{1,9}(?!\d)")
_GOAL_NUMBER = re.compile(r"(?<![\w)])-\d+|\d+(?=st|nd|rd|th|\b)|[A-Za-z]+")
_DATE = re.compile(r"\b(\d{1,2})/\d{1,2}/(\d{4})\b")
_POINTED_AT = re.compile(r"hover|-over$")  # classes of the element below the mouse, which reveal a person's next action


@dataclass(frozen=True, slots=True)
class Text:
    """The W words of the text or value of an element."""

    exact: tuple[str, ...]  # [W] words as written
    folded: tuple[str, ...]  # [W] words in lower case
    rows: tuple[int, ...]  # rows of the word vectors of the first WORDS words
    number: float  # the number or month that the text is, nan for other texts
    numbers: tuple[int, ...]  # all non-negative integers in the text, in order
    month: int  # from 1 if the text is the name of a month, else 0
    year: int  # the number if the text has four digits, else 0


@dataclass(frozen=True, slots=True)
class Kind:
    """The kind of an element in words."""

    words: tuple[str, ...]  # in lower case, at most KIND_WORDS
    tag_words: tuple[str, ...]  # the words for tag and shape
    ids: Ids  # [ELEMENT_IDS] rows of the vectors of `words`, tag, classes; 0 in other columns
    drawing: frozenset[str] | None  # words for the colour and shape of a drawing, None for other elements


@dataclass(frozen=True, slots=True)
class GoalText:
    """The L tokens of a goal."""

    rows: Ids  # [L] rows of the word vectors
    exact: tuple[str, ...]  # [L] tokens as written
    folded: tuple[str, ...]  # [L] tokens in lower case
    places: Mapping[str, list[int]]  # indices of each token as written
    folded_places: Mapping[str, list[int]]  # indices of each token in lower case
    words: frozenset[str]  # the tokens in lower case without punctuation, which matches nothing
    quoted: NDArray[np.bool_]  # [L] True between a pair of double quotes
    flags: Floats  # [L, TOKEN_FLAGS] with the overlap columns 0
    units: Floats  # [L, D] see `unit_vectors`; 0 for quoted words, numbers, punctuation and the most common words
    counted: Ids  # [N] indices of the tokens that are numbers
    counts: Floats  # [N] these numbers
    numbers: Floats  # the first numbers, at most GOAL_NUMBERS
    affixes: tuple[str, ...]  # quoted words in lower case
    month: tuple[int, int] | None  # year and month of the first date
    described: frozenset[str] | None  # words for the size, colour and shape of drawings; None without any
    characters: frozenset[str]  # single letters and digits in the goal


@functools.lru_cache(maxsize=1 << 16)
def words_of_text(text: str, vectors: Vectors) -> Text:
    """Read the text or value of an element."""
    words = tuple(TOKEN.findall(text))
    folded = tuple(word.lower() for word in words)
    month = MONTHS.index(text.lower()) + 1 if text.lower() in MONTHS else 0
    return Text(
        exact=words,
        folded=folded,
        rows=tuple(vectors.row(word) for word in words[:WORDS]),
        number=_number(text, folded),
        numbers=tuple(int(part) for part in _INTEGER.findall(text)),
        month=month,
        year=int(text) if len(text) == 4 and text.isdecimal() else 0,
    )


@functools.lru_cache(maxsize=1 << 14)
def read_kind(tag: str, classes: str, attributes: str, colour: str, shape: str, drawn: str, vectors: Vectors) -> Kind:
    """Read the kind of an element. `drawn` is the text of an SVG text element, "" for others."""
    words = [*_TAG_WORDS.get(tag, ()), *shape.split()[:1]]
    if tag == "text" and len(drawn) == 1:
        words += ["digit", "number"] if drawn.isdigit() else ["letter"]
    tag_words = tuple(words)
    words += colour_names(colour)
    names = [name for name in classes.split() if not _POINTED_AT.search(name)]
    for name in (" ".join(names), attributes):
        words += [word.lower() for word in _NAME_PART.findall(name)]
    words = list(dict.fromkeys(words))[:KIND_WORDS]
    ids = np.zeros(ELEMENT_IDS, dtype=np.int32)
    ids[ELEMENT_KIND][: len(words)] = [vectors.row(word) for word in words]
    ids[TAG] = zlib.crc32(tag.encode()) % TAGS
    buckets = [1 + zlib.crc32(name.encode()) % (CLASSES - 1) for name in names[:CLASS_SLOTS]]
    ids[CLASS][: len(buckets)] = buckets
    return Kind(words=tuple(words), tag_words=tag_words, ids=ids, drawing=_drawing(tag, colour, shape, drawn))


def _drawing(tag: str, colour: str, shape: str, drawn: str) -> frozenset[str] | None:
    if tag != "text" and not shape.split():
        return None
    kind = {"shape", shape.split()[0]} if tag != "text" else {"digit" if drawn.isdigit() else "letter"}
    return frozenset({*colour_names(colour), *kind})


@functools.lru_cache(maxsize=1 << 12)
def read_goal(goal: Goal, vectors: Vectors) -> GoalText:
    """Read a goal."""
    tokens = goal.tokens
    quote = np.array([token == '"' for token in tokens])
    quoted = (np.cumsum(quote) % 2 == 1) & ~quote
    flags = np.zeros((len(tokens), TOKEN_FLAGS), dtype=np.float32)
    flags[:, QUOTE], flags[:, QUOTED] = quote, quoted
    flags[:, PUNCTUATION] = [not token.isalnum() for token in tokens]
    flags[:, CAPITAL] = [token[:1].isupper() for token in tokens]
    flags[:, DIGIT] = [token[:1].isdigit() for token in tokens]
    folded = tuple(token.lower() for token in tokens)
    rows = np.array([vectors.row(token) for token in tokens], dtype=np.int32)
    # The two most common words are in the last two rows of the table.
    rare = (rows >= FIRST_WORD + COMMON_ROWS) & (rows < len(vectors.table) - FIRST_WORD)
    rare &= ~quoted & (flags[:, PUNCTUATION] == 0) & (flags[:, DIGIT] == 0)
    date = _DATE.search(goal.utterance)
    counted = [index for index, token in enumerate(tokens) if _INTEGER.fullmatch(token)]
    single = ((word, _single_character(word)) for word in tokens[2:])
    return GoalText(
        rows=rows,
        exact=tokens,
        folded=folded,
        places=_places(tokens),
        folded_places=_places(folded),
        words=frozenset(word for word in folded if word.isalnum()),
        quoted=quoted,
        flags=flags,
        units=unit_vectors(rows.tolist(), vectors) * rare[:, None].astype(np.float32),
        counted=np.array(counted, dtype=np.int32),
        counts=np.array([tokens[index] for index in counted], dtype=np.float32),
        numbers=np.array(_goal_numbers(goal.utterance)[:GOAL_NUMBERS], dtype=np.float32),
        affixes=tuple(word for word, inside in zip(folded, quoted, strict=True) if inside and word.isalnum()),
        month=None if date is None else (int(date.group(2)), int(date.group(1))),
        described=_description(folded),
        # "a" is an article, except as the last word.
        characters=frozenset(sign for word, sign in single if sign and (word != "a" or tokens[-1] == word)),
    )


def _places(tokens: Sequence[str]) -> dict[str, list[int]]:
    places: dict[str, list[int]] = {}
    for index, token in enumerate(tokens):
        places.setdefault(token, []).append(index)
    return places


def unit_vectors(rows: Iterable[int], vectors: Vectors) -> Floats:
    """[R, D] centred word vectors of length 1; 0 for rows without a word."""
    units = [_unit_vector(row, vectors) for row in rows]
    return np.concatenate(units).reshape(len(units), -1) if units else np.zeros((0, vectors.table.shape[1]), np.float32)


@functools.lru_cache(maxsize=1 << 14)
def _unit_vector(row: int, vectors: Vectors) -> Floats:
    """[D]"""
    centred: Floats = np.asarray(vectors.table[row]) - _centre(vectors)
    return centred * np.float32((row >= FIRST_WORD) / max(float(np.linalg.norm(centred)), 1e-6))


@functools.lru_cache(maxsize=4)
def _centre(vectors: Vectors) -> Floats:
    centre: Floats = vectors.table[FIRST_WORD:CENTRED_ROWS].mean(axis=0)
    return centre


def occurrences(tokens: tuple[str, ...], places: Mapping[str, list[int]], words: tuple[str, ...]) -> Iterator[int]:
    """The indices at which the complete sequence `words` starts in `tokens`, which are at `places`."""
    for start in places.get(words[0], ()) if words else ():
        if tokens[start : start + len(words)] == words:
            yield start


def _description(folded: tuple[str, ...]) -> frozenset[str] | None:
    """The words of a goal that describe drawings, in the singular; None without any."""
    words = {_singular(word) for word in folded}
    if not words & (_DRAWINGS | _SIZES | COLOURS):
        return None
    return frozenset(words & ((_DRAWINGS - {"item"}) | _SIZES | COLOURS))


def _singular(word: str) -> str:
    return word[:-1] if len(word) > 1 and word.endswith("s") else word


def _single_character(word: str) -> str:
    """The letter or digit in words such as "9s" or "K", "" for other words."""
    single = _singular(word)
    return single if len(single) == 1 and single.isalnum() else ""


def _number(text: str, folded: tuple[str, ...]) -> float:
    """The number or the month (from 1) that a text is, nan for other texts."""
    if text and len(text) <= 8 and _NUMBER.fullmatch(text):
        return float(text)
    if len(folded) == 1 and folded[0] in MONTHS:
        return 1.0 + MONTHS.index(folded[0])
    return np.nan


def _goal_numbers(utterance: str) -> list[float]:
    """Numbers, ordinals, months and numbers in words, in order."""
    found = []
    for match in _GOAL_NUMBER.finditer(utterance):
        word = match.group().lower()
        if word.lstrip("-").isdigit() and len(word) <= 8:
            found.append(float(word))
        elif word in _COUNTS:
            found.append(float(_COUNTS.index(word)))
        elif word in MONTHS and word != "may":
            found.append(1.0 + MONTHS.index(word))
    return found
