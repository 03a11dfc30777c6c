"""What strings say, each worked out once and cached: words, kinds of elements, colours, numbers, and runs of the goal."""

from __future__ import annotations

import colorsys
import functools
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.nets.language import FIRST_WORD, PADDING, Vectors
from giirl_core.types import TOKEN, Goal

WORDS = 14  # words of one element that are read: its text, then its value
KIND_WORDS = 8  # words for what an element is: its tag, classes, attributes, colour and shape
WHAT_WORDS = 4
TAGS = 128  # hash buckets of tag names
CLASSES = 64  # hash buckets of class names, 0 for none
CLASS_SLOTS = 3
GOAL_NUMBERS = 3  # of the goal that elements are compared with
CENTRED_ROWS = 20_000  # of the word vectors: their mean is taken off before two words are compared
COMMON_ROWS = 80  # words this frequent are like every other word
TOKEN_FLAGS = 12

Ids = NDArray[np.int32]
Floats = NDArray[np.float32]
Hashes = NDArray[np.int64]

_TAG_WORDS = {  # what a person calls an element
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
MONTHS = "january february march april may june july august september october november december".split()
_COUNTS = "zero one two three four five six seven eight nine ten".split()
_WORD = re.compile(r"[a-z]+|[A-Z][a-z]*|[^\W\d_]+")
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?![\d.]*\.\d)")
_DATE = re.compile(r"\b(\d{1,2})/\d{1,2}/(\d{4})\b")
_RGB = re.compile(r"rgba?\((\d+), ?(\d+), ?(\d+)")
_POINTED_AT = re.compile(
    r"hover|-over$"
)  # classes of what a mouse happens to be over, which says what a person does next
DRAWN_WORDS = frozenset({"shape", "letter", "digit", "rectangle", "circle", "triangle"})
_SIZES = frozenset({"small", "large"})
SMALL_PX = 15.0  # a drawing less high is small
_NAMED = {
    "aqua": (0, 255, 255),
    "black": (0, 0, 0),
    "blue": (0, 0, 255),
    "brown": (165, 42, 42),
    "cyan": (0, 255, 255),
    "gray": (128, 128, 128),
    "green": (0, 128, 0),
    "grey": (128, 128, 128),
    "lime": (0, 255, 0),
    "magenta": (255, 0, 255),
    "maroon": (128, 0, 0),
    "navy": (0, 0, 128),
    "olive": (128, 128, 0),
    "orange": (255, 165, 0),
    "pink": (255, 192, 203),
    "purple": (128, 0, 128),
    "red": (255, 0, 0),
    "silver": (192, 192, 192),
    "teal": (0, 128, 128),
    "violet": (238, 130, 238),
    "white": (255, 255, 255),
    "yellow": (255, 255, 0),
}
COLOURS = frozenset(_NAMED)
_HUES = ("red", "orange", "yellow", "green", "green", "green", "cyan", "cyan", "blue", "purple", "magenta", "pink")


@dataclass(frozen=True, slots=True)
class Text:
    """A string cut into words; W of them at most are read."""

    rows: Ids  # [WORDS] rows of the word vectors, PADDING beyond the text
    exact: tuple[str, ...]  # [W] words as written
    folded: tuple[str, ...]  # [W] in lower case
    read: Hashes  # [WORDS] of the first of these, 0 beyond the text
    number: float  # the number that the text is or names; nan for none
    numbers: tuple[int, ...]  # all numbers in it, in order


@dataclass(frozen=True, slots=True)
class Kind:
    """What an element is, in words."""

    rows: Ids  # [KIND_WORDS] of the word vectors
    hashes: Hashes  # [KIND_WORDS] of the words in lower case, 0 beyond them
    what: Hashes  # [WHAT_WORDS] of those for its tag and shape
    tag: int
    classes: tuple[int, ...]  # [CLASS_SLOTS]
    colour: tuple[float, float, float, float]  # red, green, blue in [0, 1]; 1 where there is one


@dataclass(frozen=True, slots=True)
class GoalText:
    """A goal cut into words."""

    rows: Ids  # [L]
    exact: tuple[str, ...]  # [L]
    folded: tuple[str, ...]  # [L] in lower case
    hashes: Hashes  # [L] of these; -1 for punctuation, which alone says nothing
    first: NDArray[np.int64]  # where each different one stands first
    quoted: NDArray[np.bool_]  # [L] inside a pair of double quotes
    flags: Floats  # [L, TOKEN_FLAGS], overlap not filled in
    units: Floats  # [L, D] directions of the words; zeros where a word is too common to be like another
    numbers: Floats  # [GOAL_NUMBERS] nan beyond them
    prefixes: tuple[str, ...]  # quoted words, in lower case
    month: tuple[int, int] | None  # year and month of a date
    described: frozenset[str] | None  # words that a drawing must fit, None where the goal describes none
    signs: frozenset[str]  # and the letters or digits that it must be


@functools.lru_cache(maxsize=1 << 16)
def read_text(text: str, vectors: Vectors) -> Text:
    """The words of a text."""
    words = tuple(TOKEN.findall(text))
    folded = tuple(word.lower() for word in words)
    rows = np.full(WORDS, PADDING, dtype=np.int32)
    rows[: len(words)] = [vectors.row(word) for word in words[:WORDS]]
    read = np.zeros(WORDS, dtype=np.int64)
    read[: len(words)] = hashes_of(folded[:WORDS])
    return Text(
        rows=rows, exact=words, folded=folded, read=read, number=_number_of(text, folded), numbers=_numbers_in(text)
    )


@functools.lru_cache(maxsize=1 << 14)
def read_kind(tag: str, classes: str, attributes: str, colour: str, shape: str, drawn: str, vectors: Vectors) -> Kind:
    """What an element is. `drawn` is the text of an SVG text element."""
    words = list(_TAG_WORDS.get(tag, ()))
    if shape:
        words.append(shape.split()[0])
    if tag == "text" and len(drawn) == 1:
        words += ["digit", "number"] if drawn.isdigit() else ["letter"]
    what = np.zeros(WHAT_WORDS, dtype=np.int64)
    what[: min(len(words), WHAT_WORDS)] = hashes_of(words[:WHAT_WORDS])
    red_green_blue = _colour_of(colour)
    words += _colour_words(red_green_blue)
    names = [name for name in classes.split() if not _POINTED_AT.search(name)]
    for name in (" ".join(names), attributes):
        words += [word.lower() for word in _WORD.findall(name)]
    words = list(dict.fromkeys(words))[:KIND_WORDS]
    rows = np.full(KIND_WORDS, PADDING, dtype=np.int32)
    rows[: len(words)] = [vectors.row(word) for word in words]
    hashes = np.zeros(KIND_WORDS, dtype=np.int64)
    hashes[: len(words)] = hashes_of(words)
    ids = [1 + zlib.crc32(name.encode()) % (CLASSES - 1) for name in names[:CLASS_SLOTS]]
    share = (0.0, 0.0, 0.0, 0.0) if red_green_blue is None else (*(c / 255 for c in red_green_blue), 1.0)
    return Kind(
        rows=rows,
        hashes=hashes,
        what=what,
        tag=zlib.crc32(tag.encode()) % TAGS,
        classes=(*ids, *[0] * (CLASS_SLOTS - len(ids))),
        colour=share,  # type: ignore[arg-type]
    )


@functools.lru_cache(maxsize=1 << 12)
def read_goal(goal: Goal, vectors: Vectors) -> GoalText:
    """The words of a goal."""
    tokens = goal.tokens
    quote = np.array([token == '"' for token in tokens])
    quoted = (np.cumsum(quote) % 2 == 1) & ~quote
    flags = np.zeros((len(tokens), TOKEN_FLAGS), dtype=np.float32)
    flags[:, 0], flags[:, 5] = quote, quoted
    flags[:, 1] = [not token.isalnum() for token in tokens]
    flags[:, 2] = [token[:1].isupper() for token in tokens]
    flags[:, 11] = [token[:1].isdigit() for token in tokens]
    folded = tuple(token.lower() for token in tokens)
    hashes = np.where(flags[:, 1] == 0, hashes_of(folded), -1)
    rows = np.array([vectors.row(token) for token in tokens], dtype=np.int32)
    rare = (rows >= FIRST_WORD + COMMON_ROWS) & (rows < len(vectors.table) - FIRST_WORD)  # the two commonest come last
    units = units_of(rows, vectors) * (rare & (flags[:, 1] == 0))[:, None]
    numbers = np.full(GOAL_NUMBERS, np.nan, dtype=np.float32)
    found = _goal_numbers(goal.utterance)[:GOAL_NUMBERS]
    numbers[: len(found)] = found
    return GoalText(
        rows=rows,
        exact=tokens,
        folded=folded,
        hashes=hashes,
        first=np.unique(hashes, return_index=True)[1],
        quoted=quoted,
        flags=flags,
        units=units.astype(np.float32),
        numbers=numbers,
        month=_month_of(goal.utterance),
        described=_described(folded),
        signs=frozenset(_sign(word) for word in tokens[2:] if _sign(word) and (word != "a" or tokens[-1] == word)),
        prefixes=tuple(word for word, inside in zip(folded, quoted, strict=True) if inside and word.isalnum()),
    )


def units_of(rows: NDArray[np.int32], vectors: Vectors) -> Floats:
    """[..., D] directions of word vectors less what all words have in common; zeros for words without a vector."""
    table = vectors.table[rows] - _centre(vectors)
    norm = np.linalg.norm(table, axis=-1, keepdims=True)
    known = (rows >= FIRST_WORD)[..., None]
    out: Floats = (known * table / np.maximum(norm, 1e-6)).astype(np.float32)
    return out


@functools.lru_cache(maxsize=4)
def _centre(vectors: Vectors) -> Floats:
    centre: Floats = vectors.table[FIRST_WORD:CENTRED_ROWS].mean(axis=0)
    return centre


def hashes_of(words: Sequence[str]) -> Hashes:
    """Python's own 64-bit hashes: equal for equal words, in this process alone."""
    return np.array([hash(word) for word in words], dtype=np.int64)


@functools.lru_cache(maxsize=1 << 16)
def runs(tokens: tuple[str, ...], words: tuple[str, ...]) -> tuple[int, ...]:
    """Where `words`, whole and in order, begin in `tokens`."""
    return tuple(_runs(tokens, words))


def _runs(tokens: tuple[str, ...], words: tuple[str, ...]) -> Iterator[int]:
    if words and words[0] in tokens:
        for start in range(tokens.index(words[0]), len(tokens) - len(words) + 1):
            if tokens[start : start + len(words)] == words:
                yield start


def _number_of(text: str, folded: tuple[str, ...]) -> float:
    if text and len(text) <= 8 and _NUMBER.fullmatch(text):
        return float(text)
    if len(folded) == 1 and folded[0] in MONTHS:
        return 1.0 + MONTHS.index(folded[0])
    return np.nan


def _described(folded: tuple[str, ...]) -> frozenset[str] | None:
    """The words of a goal that describe drawings: their sizes, colours and shapes, in the singular."""
    words = {_singular(word) for word in folded}
    if not words & (DRAWN_WORDS | {"item"} | _SIZES) and not words & _NAMED.keys():
        return None
    return frozenset(words & (DRAWN_WORDS | _SIZES | _NAMED.keys()))


def _singular(word: str) -> str:
    return word[:-1] if len(word) > 1 and word.endswith("s") else word


def _sign(word: str) -> str:
    """The letter or digit in "9s" or "K", "" for other words."""
    single = _singular(word)
    return single if len(single) == 1 and single.isalnum() else ""


def described_as(tag: str, colour: str, shape: str, text: str, height: float) -> frozenset[str]:
    """The words that describe a drawing, none for other elements."""
    if tag != "text" and not shape:
        return frozenset()
    words = {"small" if height < SMALL_PX else "large", *_colour_words(_colour_of(colour))}
    if tag == "text":
        words.add("digit" if text.isdigit() else "letter")
    else:
        words |= {"shape", shape.split()[0]}
    return frozenset(words)


def _month_of(utterance: str) -> tuple[int, int] | None:
    found = _DATE.search(utterance)
    return None if found is None else (int(found.group(2)), int(found.group(1)))


def _numbers_in(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"(?<!\d)\d{1,9}(?!\d)", text))


def _goal_numbers(utterance: str) -> list[float]:
    """Numbers, ordinals and counts in words, in order."""
    found = []
    for match in re.finditer(r"(?<![\w)])-\d+|\d+(?=st|nd|rd|th|\b)|[A-Za-z]+", utterance):
        word = match.group().lower()
        if word.lstrip("-").isdigit() and len(word) <= 8:
            found.append(float(word))
        elif word in _COUNTS:
            found.append(float(_COUNTS.index(word)))
        elif word in MONTHS and word != "may":
            found.append(1.0 + MONTHS.index(word))
    return found


@functools.lru_cache(maxsize=1 << 12)
def _colour_of(colour: str) -> tuple[int, int, int] | None:
    if colour.lower() in _NAMED:
        return _NAMED[colour.lower()]
    found = _RGB.match(colour)
    if found is not None:
        red, green, blue = (int(part) for part in found.groups())
        return red, green, blue
    if re.fullmatch(r"#[0-9a-fA-F]{6}", colour):
        return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
    return None


def _colour_words(colour: tuple[int, int, int] | None) -> list[str]:
    """Its names where it is a colour of CSS, else the name of its hue."""
    if colour is None:
        return []
    names = [name for name, parts in _NAMED.items() if parts == colour]
    if names:
        return names
    hue, lightness, saturation = colorsys.rgb_to_hls(*(part / 255 for part in colour))
    if saturation < 0.08:
        return ["white" if lightness > 0.9 else "black" if lightness < 0.1 else "gray"]
    return [_HUES[int(hue * 12 + 0.5) % 12]]
