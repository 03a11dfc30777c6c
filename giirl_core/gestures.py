"""Gestures: actions without their targets, which are what the nets can do to an element of a page."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from giirl_core.actions import NO_SPAN, Action, Verb
from giirl_core.config.sections import SHOWN
from giirl_core.pages import Page

MAX_GESTURES = 64  # of a run
NOWHERE = (0.0, 0.0)  # no distance
TYPING = frozenset({Verb.TYPE, Verb.APPEND, Verb.ACTIVATE})


class Takes(Enum):
    """What a gesture needs besides the element that it is made on."""

    NOTHING = ""
    WORDS = "words"  # of the goal, which it types
    TEXT_OF = "text-of"  # another element, whose value or text it types
    TO = "to"  # another element, where it ends


class Allowed(Enum):
    """The elements of a page that a gesture can be made on."""

    LEAVES = 0
    FIELDS = 1  # text fields
    ALL = 2
    FIRST = 3  # a gesture that needs no element, as waiting, is made on the first


@dataclass(frozen=True, slots=True, kw_only=True)
class Gesture:
    """An action without its target.

    As text: its verb, what it takes, its text or key, and its distances, such as `click`, `type words`, `press Enter`,
    `type "yes"`, `drag to by 0 5` or `drag across`.
    """

    verb: Verb
    takes: Takes = Takes.NOTHING
    literal: str = ""  # as Action.literal
    at: tuple[float, float] = NOWHERE  # CSS px, as Action.at
    by: tuple[float, float] = NOWHERE  # CSS px, as Action.by
    across: bool = False  # from one corner of the element to the opposite one, in place of `at` and `by`

    def __str__(self) -> str:
        literal = self.literal if self.verb is Verb.PRESS else json.dumps(self.literal, ensure_ascii=False)
        parts = [self.verb.name.lower(), self.takes.value, literal if self.literal else "", "across" * self.across]
        parts += [f"{name} {x:g} {y:g}" for name, (x, y) in (("at", self.at), ("by", self.by)) if (x, y) != NOWHERE]
        return " ".join(filter(None, parts))

    @property
    def allowed(self) -> Allowed:
        """The elements that it can be made on."""
        if self.verb is Verb.WAIT:
            return Allowed.FIRST
        if self == CLICK:
            return Allowed.LEAVES
        return Allowed.FIELDS if self.verb in (Verb.TYPE, Verb.APPEND) else Allowed.ALL

    @property
    def has_second(self) -> bool:
        """Whether it takes another element."""
        return self.takes in (Takes.TEXT_OF, Takes.TO)


CLICK, TYPE_WORDS = Gesture(verb=Verb.CLICK), Gesture(verb=Verb.TYPE, takes=Takes.WORDS)
BASIC = (CLICK, TYPE_WORDS)  # every run has these two
_NUMBER = r"-?\d+(?:\.\d+)?"
_GESTURE = re.compile(
    r"(?P<verb>[a-z_]+)(?: (?P<takes>words|text-of|to))?"
    rf'(?: (?P<literal>"(?:[^"\\]|\\.)*"|(?<=press )\S+))?(?P<across> across)?'
    rf"(?: at (?P<at>{_NUMBER} {_NUMBER}))?(?: by (?P<by>{_NUMBER} {_NUMBER}))?"
)


def read_gesture(text: str) -> Gesture:
    """The inverse of `str`; ValueError, one line, for a text that is no gesture."""
    found = _GESTURE.fullmatch(text)
    try:
        if found is None:
            raise ValueError
        literal = found["literal"] or ""
        gesture = Gesture(
            verb=Verb[found["verb"].upper()],
            takes=Takes(found["takes"] or ""),
            literal=json.loads(literal) if literal.startswith('"') else literal,
            at=_pair(found["at"]),
            by=_pair(found["by"]),
            across=bool(found["across"]),
        )
        if (gesture.across or gesture.takes is Takes.TO) and gesture.verb is not Verb.DRAG:
            raise ValueError
        if gesture.takes in (Takes.WORDS, Takes.TEXT_OF) and (gesture.verb not in TYPING or gesture.literal):
            raise ValueError
        span = 0 if gesture.takes is Takes.WORDS else NO_SPAN
        Action(
            verb=gesture.verb, element=0, literal=gesture.literal, at=gesture.at, by=gesture.by, start=span, end=span
        )
    except (ValueError, KeyError):
        raise ValueError(
            f"{text!r:.80} is no gesture: wanted one such as 'hover', 'press Enter' or 'drag to'"
        ) from None
    return gesture


def _pair(text: str | None) -> tuple[float, float]:
    across, down = map(float, (text or "0 0").split())
    return across, down


def read_gestures(texts: Sequence[str]) -> tuple[Gesture, ...]:
    """The gestures of a run, by their numbers: the basic two, then those of `texts`. ValueError for too many.

    SHOWN stands for none: what demonstrations show is filled in when they are there.
    """
    gestures = tuple(dict.fromkeys((*BASIC, *(read_gesture(text) for text in texts if text != SHOWN))))
    if len(gestures) > MAX_GESTURES:
        raise ValueError(f"there are {len(gestures)} gestures: wanted at most {MAX_GESTURES}")
    return gestures


def allowed_elements(gesture: Gesture, page: Page) -> NDArray[np.bool_]:
    """[E] True for the elements of a page that a gesture can be made on."""
    if gesture.allowed is Allowed.LEAVES:
        return page.leaf
    if gesture.allowed is Allowed.FIELDS:
        return page.typable
    return np.arange(len(page)) < (1 if gesture.allowed is Allowed.FIRST else len(page))
