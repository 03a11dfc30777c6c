"""What a scripted expert sees of a page and may do on it, in the words that experts think in."""

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
    """One observation, the very one that a policy gets. Whatever is not on the page is a ValueError."""

    seen: Observation

    @property
    def page(self) -> Page:
        return self.seen.page

    @property
    def said(self) -> str:
        """The instruction."""
        return self.seen.goal.utterance

    def words(self, pattern: str | re.Pattern[str]) -> str:
        """The first group of a pattern in the instruction."""
        match = re.search(pattern, self.said)
        if match is None:
            raise ValueError(f"the instruction {self.said!r} does not read like {pattern}")
        return str(match.group(1))

    def quoted(self) -> list[str]:
        """What stands in quotation marks in the instruction."""
        return QUOTED.findall(self.said)

    # ---- rows

    def rows(
        self, tag: str | None = None, text: str | None = None, kind: str | None = None, inside: int | None = None
    ) -> list[int]:
        """Rows with this tag, this text, this among their classes, somewhere below this row."""
        page = self.page
        rows = range(len(page)) if inside is None else self.page.descendants(inside)
        return [
            row
            for row in rows
            if (tag is None or page.tag[row] == tag)
            and (text is None or page.text[row] == text)
            and (kind is None or kind in page.classes[row].split())
        ]

    def row(
        self, tag: str | None = None, text: str | None = None, kind: str | None = None, inside: int | None = None
    ) -> int:
        """The first of `rows`."""
        rows = self.rows(tag, text, kind, inside)
        if not rows:
            wanted = ", ".join(
                f"{n} {v!r}" for n, v in (("tag", tag), ("text", text), ("class", kind)) if v is not None
            )
            raise ValueError(f"nothing with {wanted} on the page of {self.seen.episode}")
        return rows[0]

    def above(self, row: int, tag: str | None = None, kind: str | None = None) -> int:
        """The nearest row around this one with such a tag and class."""
        around = self.rows(tag, None, kind)
        parent = int(self.page.parent[row])
        while parent >= 0:
            if parent in around:
                return parent
            parent = int(self.page.parent[parent])
        raise ValueError(f"row {row} of the page of {self.seen.episode} lies in no {tag or ''}{kind or ''}")

    def reading(self, row: int) -> str:
        """All the text of a row and what is in it."""
        return " ".join(self.page.text[each] for each in (row, *self.page.descendants(row)) if self.page.text[each])

    def leaf(self, row: int) -> int:
        """The first leaf of a row, itself where it is one: what a policy may click."""
        below = self.page.descendants(row)
        return next((each for each in below if self.page.leaf[each]), row)

    def has(self, row: int, kind: str) -> bool:
        """Whether a class is among the row's."""
        return kind in self.page.classes[row].split()

    def centre(self, row: int) -> tuple[float, float]:
        """The middle of a row's box, px."""
        left, top, width, height = (float(each) for each in self.page.box[row])
        return left + width / 2, top + height / 2

    # ---- actions

    def click(self, row: int, at: Offset = CENTRE) -> Action:
        return Action(verb=Verb.CLICK, element=row, at=at)

    def press_button(self, text: str) -> Action:
        """Click the button that reads exactly `text`."""
        return self.click(self.row("button", text))

    def press(self, key: str, row: int = NO_ELEMENT) -> Action:
        """A key or a chord, in a row or where the focus is."""
        return Action(verb=Verb.PRESS, element=row, literal=key)

    def wait(self) -> Action:
        return Action(verb=Verb.WAIT)

    def hover(self, row: int) -> Action:
        return Action(verb=Verb.HOVER, element=row)

    def drag(self, row: int, to: int = NO_ELEMENT, at: Offset = CENTRE, by: Offset = CENTRE) -> Action:
        """From a row, `by` so much or to another row and `by` so much from there."""
        return Action(verb=Verb.DRAG, element=row, to=to, at=at, by=by)

    def scroll(self, row: int, down: float) -> Action:
        return Action(verb=Verb.SCROLL, element=row, by=(0.0, down))

    def type(self, row: int, text: str) -> Action:
        """Replace what a field holds: with words of the instruction where it has them."""
        start, end = self.seen.goal.find(text)
        literal = text if start == NO_SPAN else ""
        return Action(verb=Verb.TYPE, element=row, start=start, end=end, literal=literal)

    def fill(self, wanted: dict[int, str]) -> Action | None:
        """Type into the first field that does not hold what it should; None when all do."""
        for row, text in wanted.items():
            if self.page.value[row] != text:
                return self.type(row, text)
        return None


class NoAction(ValueError):
    """The expert finds nothing to do on a page."""


Player = Callable[[PageView], Action]
EXPERTS: dict[str, Player] = {}


def expert_for(*tasks: str) -> Callable[[Player], Player]:
    """Name the tasks that a function plays."""

    def enter(player: Player) -> Player:
        for task in tasks:
            assert task not in EXPERTS, f"two experts for {task}"
            EXPERTS[task] = player
        return player

    return enter


def expert(task: str) -> Callable[[Observation], Action]:
    """The scripted player of a task; it sees what a policy sees and nothing else."""
    if task not in EXPERTS:
        near = difflib.get_close_matches(task, EXPERTS, n=1, cutoff=0.0)[0]
        raise ValueError(f"no scripted expert plays {task!r}: did you mean {near!r}? ({len(EXPERTS)} tasks have one)")
    player = EXPERTS[task]

    def play(seen: Observation) -> Action:
        try:
            return player(PageView(seen))
        except (ValueError, LookupError, StopIteration) as error:
            raise NoAction(f"the expert of {seen.episode} finds nothing to do: {error}") from error

    return play
