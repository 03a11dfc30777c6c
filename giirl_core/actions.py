"""Goals (instructions in English) and actions on a page."""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum

from giirl_core.keys import parse_chord

NO_SPAN = -1
NO_ELEMENT = -1  # Action.element, .to: no element
TOKEN = re.compile(r"\w+|[^\w\s]")
RANGE = re.compile(r"\bbetween (\d{1,9}) ?(?:-|and|to) ?(\d{1,9})\b", re.IGNORECASE)
CASE = re.compile(r"\b(upper|lower)[ -]?case\b", re.IGNORECASE)
QUOTED = re.compile(r'"([^"]*)"')
WORD = re.compile(r"\w+")
SALT = "unseen"  # chosen so that no word is held out that another instruction of the same study has outside quotes
BUCKETS = 10_000  # of the hash of a goal
MAX_IMPLIED = 20  # numbers of a range; a longer one implies none


@dataclass(frozen=True, slots=True)
class Goal:
    """An instruction in English, tokenised into words and single punctuation marks; case is kept.

    A range, as in "Guess the number between 0-9", implies numbers that the utterance does not contain, and "in upper
    case" implies quoted words in another case. They are tokens too, after all others, so that they can be typed.
    Raises ValueError when the utterance has no token.
    """

    utterance: str
    tokens: tuple[str, ...] = field(init=False, compare=False)  # [L]
    offsets: tuple[tuple[int, int], ...] = field(
        init=False, compare=False
    )  # character span of each token of the utterance, end excluded

    def __post_init__(self) -> None:
        matches = list(TOKEN.finditer(self.utterance))
        if not matches:
            raise ValueError(f"Goal.utterance is {self.utterance!r}, wanted at least one word")
        written = tuple(m.group() for m in matches)
        object.__setattr__(
            self, "tokens", written + _implied_numbers(self.utterance, written) + _implied_case(self.utterance)
        )
        object.__setattr__(self, "offsets", tuple(m.span() for m in matches))

    @property
    def quoted(self) -> tuple[str, ...]:
        """The texts in quotes, in order."""
        return tuple(QUOTED.findall(self.utterance))

    def span(self, start: int, end: int) -> str:
        """The characters of the utterance from token `start` to token `end`, both included."""
        if end >= len(self.offsets):
            return " ".join(self.tokens[start : end + 1])
        return self.utterance[self.offsets[start][0] : self.offsets[end][1]]

    def find(self, text: str) -> tuple[int, int]:
        """The first token span whose characters equal `text`, in quotes if there is one; (-1, -1) if there is none."""
        tokens = tuple(m.group() for m in TOKEN.finditer(text))
        spans = [
            (start, start + len(tokens) - 1)
            for start in range(len(self.tokens) - len(tokens) + 1)
            if tokens and self.tokens[start : start + len(tokens)] == tokens
        ]
        spans = [span for span in spans if self.span(*span) == text]
        quoted = [span for span in spans if self.tokens[span[0] - 1 : span[0]] == ('"',)]
        return (quoted or spans or [(NO_SPAN, NO_SPAN)])[0]


def _implied_numbers(utterance: str, written: Sequence[str]) -> tuple[str, ...]:
    """The numbers of the first range in an utterance that are not written there."""
    found = RANGE.search(utterance)
    if found is None:
        return ()
    low, high = int(found[1]), int(found[2])
    return tuple(str(n) for n in range(low, high + 1) if str(n) not in written) if high - low < MAX_IMPLIED else ()


def _implied_case(utterance: str) -> tuple[str, ...]:
    """The quoted words in the case that the utterance asks for, if they are not written so."""
    found = CASE.search(utterance)
    if found is None:
        return ()
    to_case = str.upper if found[1].lower() == "upper" else str.lower
    quoted = TOKEN.findall(" ".join(QUOTED.findall(utterance)))
    changed = tuple(map(to_case, quoted))
    return changed if list(changed) != quoted else ()


def is_held_out(goal: Goal, fraction: float) -> bool:
    """True for about `fraction` of all goals, the same ones in every run.

    The decision is a hash of the goal's quoted strings (a button's label, a name to type, a link); of the whole
    utterance when nothing is quoted. Only the words matter, not their case nor the punctuation between them.
    """
    quoted = goal.quoted or (goal.utterance,)
    words = WORD.findall(" ".join(quoted).lower())
    return zlib.crc32(" ".join([SALT, *words]).encode()) % BUCKETS < fraction * BUCKETS


class Verb(IntEnum):
    """The kind of an action on an element or at a point of the page. The wire and the files store the numbers."""

    CLICK = 0
    TYPE = 1  # replace the text of a field (`fill` in Playwright)
    APPEND = 2  # type at the end of a field; without an element, into the focused one
    PRESS = 3  # a key or a key combination
    SCROLL = 4  # mouse wheel
    DRAG = 5
    HOVER = 6
    DOUBLE_CLICK = 7
    MOUSE_DOWN = 8  # press the mouse button and hold it
    MOUSE_UP = 9
    ACTIVATE = 10  # call click() and focus() as a script does, without moving the mouse; then type like APPEND
    WAIT = 11  # do nothing for one step


_POINT_FIELDS = frozenset({"at"})
_TEXT_FIELDS = frozenset({"start", "end", "literal"})
VERB_FIELDS: dict[Verb, frozenset[str]] = {  # the optional fields of Action that each verb uses
    **dict.fromkeys((Verb.CLICK, Verb.HOVER, Verb.DOUBLE_CLICK, Verb.MOUSE_DOWN, Verb.MOUSE_UP), _POINT_FIELDS),
    **dict.fromkeys((Verb.TYPE, Verb.APPEND, Verb.ACTIVATE), _TEXT_FIELDS),
    Verb.PRESS: frozenset({"literal"}),
    Verb.SCROLL: frozenset({"at", "by"}),
    Verb.DRAG: frozenset({"at", "by", "to"}),
    Verb.WAIT: frozenset(),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """One action on a page: a verb, its target, and the fields that the verb uses (VERB_FIELDS).

    The target is an element (a row of `Page`), or a point of the page. Raises ValueError when a field is set that the
    verb does not use, or when a value is out of range.
    """

    verb: Verb
    element: int = NO_ELEMENT  # row of the page; -1: the page itself, or the focused element
    start: int = NO_SPAN  # first token of the text to type; -1: nothing is typed, or the text is in `literal`
    end: int = NO_SPAN  # last token of the text to type, included
    literal: str = ""  # TYPE, APPEND, ACTIVATE: text that is not in the goal; PRESS: the key, "Enter" or "Control+c"
    at: tuple[float, float] = (0.0, 0.0)  # CSS px from the element's centre; without an element, from the page's corner
    by: tuple[float, float] = (0.0, 0.0)  # CSS px. SCROLL: distance; DRAG: end, from the centre of `to` or from `at`
    to: int = NO_ELEMENT  # DRAG: row of the element where it ends

    def __post_init__(self) -> None:
        used = VERB_FIELDS[self.verb]
        for name, value, default in (
            ("start", self.start, NO_SPAN),
            ("end", self.end, NO_SPAN),
            ("literal", self.literal, ""),
            ("at", self.at, (0.0, 0.0)),
            ("by", self.by, (0.0, 0.0)),
            ("to", self.to, NO_ELEMENT),
        ):
            if value != default and name not in used:
                raise ValueError(f"{self.verb.name} takes no {name!r}, got {value!r}")
        if self.element < NO_ELEMENT or self.to < NO_ELEMENT:
            raise ValueError(f"Action.element is {self.element} and .to is {self.to}, wanted rows of the page, or -1")
        if not (self.start == self.end == NO_SPAN or 0 <= self.start <= self.end):
            raise ValueError(f"Action.start..end is {self.start}..{self.end}, wanted a span of tokens, or -1..-1")
        if self.literal and self.start != NO_SPAN:
            raise ValueError(
                f"Action has literal {self.literal!r} and tokens {self.start}..{self.end}, wanted only one"
            )
        if not all(map(math.isfinite, (*self.at, *self.by))):
            raise ValueError(f"Action.at is {self.at} and .by is {self.by}, wanted finite numbers of px")
        if self.verb is Verb.PRESS:
            parse_chord(self.literal)

    def text(self, goal: Goal) -> str:
        """The text to type or the key to press; "" for verbs that use neither."""
        return goal.span(self.start, self.end) if self.start >= 0 else self.literal
