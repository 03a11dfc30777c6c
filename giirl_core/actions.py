"""Goals and actions: an instruction in words, and what may be done about it on a page."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from enum import IntEnum

from giirl_core.keys import chord

NO_SPAN = -1
NO_ELEMENT = -1  # Action.element, .to: none of the page's rows


TOKEN = re.compile(r"\w+|[^\w\s]")


@dataclass(frozen=True, slots=True)
class Goal:
    """An instruction in English, cut into words and single punctuation marks; case is kept."""

    utterance: str
    tokens: tuple[str, ...] = field(init=False, compare=False)  # [L]
    offsets: tuple[tuple[int, int], ...] = field(init=False, compare=False)  # [L] characters, end excluded

    def __post_init__(self) -> None:
        matches = list(TOKEN.finditer(self.utterance))
        if not matches:
            raise ValueError(f"a goal needs at least one word, got {self.utterance!r}")
        object.__setattr__(self, "tokens", tuple(m.group() for m in matches))
        object.__setattr__(self, "offsets", tuple(m.span() for m in matches))

    def span(self, start: int, end: int) -> str:
        """The instruction's own characters from token `start` to token `end`, both included."""
        return self.utterance[self.offsets[start][0] : self.offsets[end][1]]

    def find(self, text: str) -> tuple[int, int]:
        """The first token span that reads exactly `text`, preferring one in quotes; (-1, -1) when there is none."""
        wanted = tuple(m.group() for m in TOKEN.finditer(text))
        spans = [
            (start, start + len(wanted) - 1)
            for start in range(len(self.tokens) - len(wanted) + 1)
            if wanted and self.tokens[start : start + len(wanted)] == wanted
        ]
        spans = [span for span in spans if self.span(*span) == text]
        quoted = [span for span in spans if self.tokens[span[0] - 1 : span[0]] == ('"',)]
        return (quoted or spans or [(NO_SPAN, NO_SPAN)])[0]


class Verb(IntEnum):
    """What an action does, to its element or at its place on the page."""

    CLICK = 0
    TYPE = 1  # replace what the field holds
    APPEND = 2  # type behind what the field holds; without an element, where the focus is
    PRESS = 3  # a key or a chord
    SCROLL = 4  # turn the wheel
    DRAG = 5
    HOVER = 6
    DOUBLE_CLICK = 7
    MOUSE_DOWN = 8  # and hold
    MOUSE_UP = 9
    ACTIVATE = 10  # what a script's click() and focus() do: no mouse moves; then type behind what has the focus
    WAIT = 11  # nothing, for as long as a step takes


LEARNED = frozenset({Verb.CLICK, Verb.TYPE})  # what the nets can choose and judge
_POINTED = frozenset({"at"})
_SAID = frozenset({"start", "end", "literal"})
USES: dict[Verb, frozenset[str]] = {
    **dict.fromkeys((Verb.CLICK, Verb.HOVER, Verb.DOUBLE_CLICK, Verb.MOUSE_DOWN, Verb.MOUSE_UP), _POINTED),
    **dict.fromkeys((Verb.TYPE, Verb.APPEND, Verb.ACTIVATE), _SAID),
    Verb.PRESS: frozenset({"literal"}),
    Verb.SCROLL: frozenset({"at", "by"}),
    Verb.DRAG: frozenset({"at", "by", "to"}),
    Verb.WAIT: frozenset(),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """What the policy chose: a verb, a row of the page or a place on it, and what the verb needs besides."""

    verb: Verb
    element: int = NO_ELEMENT  # row of the page; -1: the page itself, or what has the focus
    start: int = NO_SPAN  # token of the goal, -1 where nothing is typed or the text is not in the goal
    end: int = NO_SPAN  # token of the goal, included
    literal: str = ""  # TYPE, APPEND: text that is not in the goal; PRESS: the key, "Enter" or "Control+c"
    at: tuple[float, float] = (0.0, 0.0)  # CSS px from the element's middle; without one, from the page's corner
    by: tuple[float, float] = (0.0, 0.0)  # CSS px. SCROLL: how far; DRAG: end, from the middle of `to` or the start
    to: int = NO_ELEMENT  # DRAG: row where it ends

    def __post_init__(self) -> None:
        uses = USES[self.verb]
        for name, value, none in (
            ("start", self.start, NO_SPAN),
            ("end", self.end, NO_SPAN),
            ("literal", self.literal, ""),
            ("at", self.at, (0.0, 0.0)),
            ("by", self.by, (0.0, 0.0)),
            ("to", self.to, NO_ELEMENT),
        ):
            if value != none and name not in uses:
                raise ValueError(f"{self.verb.name} takes no {name!r}, got {value!r}")
        if self.element < NO_ELEMENT or self.to < NO_ELEMENT:
            raise ValueError(f"an action names row {min(self.element, self.to)}: wanted a row of the page, or -1")
        if not (self.start == self.end == NO_SPAN or 0 <= self.start <= self.end):
            raise ValueError(f"an action copies words {self.start}..{self.end}: wanted a span, or -1..-1")
        if self.literal and self.start != NO_SPAN:
            raise ValueError(f"an action types both {self.literal!r} and words {self.start}..{self.end} of the goal")
        if not all(map(math.isfinite, (*self.at, *self.by))):
            raise ValueError(f"an action is at {self.at} by {self.by}: wanted finite numbers of px")
        if self.verb is Verb.PRESS:
            chord(self.literal)

    def text(self, goal: Goal) -> str:
        """The text to type or the key to press, "" for what uses neither."""
        return goal.span(self.start, self.end) if self.start >= 0 else self.literal

    @property
    def learned(self) -> bool:
        """True for what the nets can choose: a click on a row, or words of the goal into one."""
        return self.verb in LEARNED and self.element >= 0 and self.at == (0.0, 0.0) and not self.literal
