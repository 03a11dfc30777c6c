"""The view of a page that scripted experts use: look up rows, read the instruction, build actions."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable
from dataclasses import dataclass

from giirl_core.types import NO_ELEMENT, NO_SPAN, Action, Observation, Page, Verb

QUOTED = re.compile(r'"(.*?)"')
Offset = tuple[float, float]  # CSS px
CENTRE: Offset = (0.0, 0.0)
ORDINAL = re.compile(r"\b(\d+)(?:st|nd|rd|th)\b")


@dataclass(frozen=True, slots=True)
class PageView:
    """One observation, the same that a policy gets. Lookups raise ValueError if the page has no such row."""

    observation: Observation

    @property
    def page(self) -> Page:
        """The page of the observation."""
        return self.observation.page

    @property
    def instruction(self) -> str:
        """The text of the goal."""
        return self.observation.goal.utterance

    def extract(self, pattern: str | re.Pattern[str]) -> str:
        """The first group of a regular expression in the instruction. ValueError if it does not match."""
        match = re.search(pattern, self.instruction)
        if match is None:
            raise ValueError(f"the instruction is {self.instruction!r}, wanted a match of {pattern}")
        return str(match.group(1))

    def quoted(self) -> list[str]:
        """The quoted strings of the instruction."""
        return QUOTED.findall(self.instruction)

    # ---- rows

    def rows(
        self, tag: str | None = None, text: str | None = None, css_class: str | None = None, inside: int | None = None
    ) -> list[int]:
        """Rows with this tag, exactly this text and this CSS class, below the row `inside`. None matches everything."""
        page = self.page
        rows = range(len(page)) if inside is None else self.page.descendants(inside)
        return [
            row
            for row in rows
            if (tag is None or page.tag[row] == tag)
            and (text is None or page.text[row] == text)
            and (css_class is None or css_class in page.classes[row].split())
        ]

    def row(
        self, tag: str | None = None, text: str | None = None, css_class: str | None = None, inside: int | None = None
    ) -> int:
        """The first of `rows`. ValueError if there is none."""
        rows = self.rows(tag, text, css_class, inside)
        if not rows:
            wanted = ", ".join(
                f"{n} {v!r}" for n, v in (("tag", tag), ("text", text), ("class", css_class)) if v is not None
            )
            raise ValueError(f"the page has no row with {wanted}")
        return rows[0]

    def ancestor(self, row: int, tag: str | None = None, css_class: str | None = None) -> int:
        """The nearest ancestor of a row with this tag and CSS class. ValueError if there is none."""
        candidates = self.rows(tag, None, css_class)
        parent = int(self.page.parent[row])
        while parent >= 0:
            if parent in candidates:
                return parent
            parent = int(self.page.parent[parent])
        wanted = " ".join(filter(None, (tag, css_class)))
        raise ValueError(f"row {row} of the page has no ancestor {wanted!r}")

    def all_text(self, row: int) -> str:
        """The text of a row and of its descendants, joined by spaces."""
        return " ".join(self.page.text[each] for each in (row, *self.page.descendants(row)) if self.page.text[each])

    def first_leaf(self, row: int) -> int:
        """The first leaf below a row, or the row itself if it is a leaf. Policies click leaves only."""
        below = self.page.descendants(row)
        return next((each for each in below if self.page.leaf[each]), row)

    def has_class(self, row: int, css_class: str) -> bool:
        """Whether a row has this CSS class."""
        return css_class in self.page.classes[row].split()

    # ---- actions

    def click(self, row: int, at: Offset = CENTRE) -> Action:
        """Click a row, `at` an offset from its centre."""
        return Action(verb=Verb.CLICK, element=row, at=at)

    def click_button(self, text: str) -> Action:
        """Click the button with exactly this text."""
        return self.click(self.row("button", text))

    def press(self, key: str, row: int = NO_ELEMENT) -> Action:
        """Press a key or a chord in a row, or in the focused element."""
        return Action(verb=Verb.PRESS, element=row, literal=key)

    def wait(self) -> Action:
        """Do nothing for one step."""
        return Action(verb=Verb.WAIT)

    def hover(self, row: int) -> Action:
        """Move the mouse to a row."""
        return Action(verb=Verb.HOVER, element=row)

    def drag(self, row: int, to: int = NO_ELEMENT, at: Offset = CENTRE, by: Offset = CENTRE) -> Action:
        """Drag from a row, `at` an offset from its centre, to the centre of the row `to` (or the start) plus `by`."""
        return Action(verb=Verb.DRAG, element=row, to=to, at=at, by=by)

    def scroll(self, row: int, down: float) -> Action:
        """Scroll a row by `down` px, upwards if negative."""
        return Action(verb=Verb.SCROLL, element=row, by=(0.0, down))

    def type(self, row: int, text: str) -> Action:
        """Replace the value of a field by a text, as a span of the instruction if it has one."""
        start, end = self.observation.goal.find(text)
        literal = text if start == NO_SPAN else ""
        return Action(verb=Verb.TYPE, element=row, start=start, end=end, literal=literal)

    def fill(self, wanted: dict[int, str]) -> Action | None:
        """Type into the first field whose value is not the wanted one. None if all values are right."""
        for row, text in wanted.items():
            if self.page.value[row] != text:
                return self.type(row, text)
        return None


class NoAction(ValueError):
    """The expert has no action for a page."""


Expert = Callable[[PageView], Action]
EXPERTS: dict[str, Expert] = {}


def expert_for(*tasks: str) -> Callable[[Expert], Expert]:
    """Decorator: register a function as the expert of these tasks."""

    def register(function: Expert) -> Expert:
        for task in tasks:
            assert task not in EXPERTS, f"two experts for {task}"
            EXPERTS[task] = function
        return function

    return register


def expert(task: str) -> Callable[[Observation], Action]:
    """The scripted expert of a task, as a function from observations to actions.

    ValueError for a task without an expert. The function raises NoAction if the expert has no action for a page.
    """
    if task not in EXPERTS:
        near = difflib.get_close_matches(task, EXPERTS, n=1, cutoff=0.0)[0]
        raise ValueError(f"{task!r} has no scripted expert: did you mean {near!r}? ({len(EXPERTS)} tasks have one)")
    function = EXPERTS[task]

    def act(observation: Observation) -> Action:
        try:
            return function(PageView(observation))
        except (ValueError, LookupError, StopIteration) as error:
            raise NoAction(f"the expert has no action for {observation.episode}: {error}") from error

    return act
