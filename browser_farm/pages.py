"""Speaks with page.js: writes its calls, and turns its replies into pages and goals."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from browser_farm.tasks import needs_fresh_document
from giirl_core import keys
from giirl_core.types import Command, EpisodeSpec, Goal, Page

FOCUSED = 1
TAMPERED = 2
GONE = "gone"  # what a document without an open episode answers
WAIT = "wait"  # the page is still loading: LATER has the answer
LATER = "giirl.later()"
DRAWN = "giirl.drawn()"  # once Chrome has drawn what a turn of the wheel moved
Json = list[Any]
SCRIPTS = ("clock", "focus", "keyboard", "gestures", "reading", "elements", "frame", "page")


def source(name: str) -> str:
    """One of the scripts of this package."""
    return (Path(__file__).parent / "js" / f"{name}.js").read_text(encoding="utf-8")


def start_call(episode: EpisodeSpec) -> Json:
    return [[episode.seed, episode.mode]]


def step_call(command: Command, task: str) -> Json:
    """Act, and go on in the same document when the episode that follows has the same task."""
    following = command.following
    stays = following is not None and following.task == task and not needs_fresh_document(task)
    begins = [following.seed, following.mode] if following is not None and stays else None
    return [_told(command), command.last, begins]


def aim_call(command: Command) -> Json:
    """Ask where the input events of an action have to go."""
    return [_told(command), True]


def _told(command: Command) -> Json:
    return [int(command.verb), command.ref, command.text, *command.at, *command.by, command.to]


def decode_page(columns: list[Any]) -> Page:
    tag, text, value, classes, numbers, boxes, looks = columns
    table = np.array(numbers, dtype=np.int32).reshape(-1, 3)
    flags = table[:, 2]
    return Page(
        tag=tuple(tag),
        text=tuple(text),
        value=tuple(value),
        classes=tuple(classes),
        ref=table[:, 0].copy(),
        parent=table[:, 1].astype(np.int16),
        box=np.array(boxes, dtype=np.float32).reshape(-1, 4),
        focused=(flags & FOCUSED) != 0,
        tampered=(flags & TAMPERED) != 0,
        colour=_scattered(looks[::4], looks[1::4], len(tag)),
        shape=_scattered(looks[::4], looks[2::4], len(tag)),
        attributes=_scattered(looks[::4], looks[3::4], len(tag)),
    )


def _scattered(rows: list[int], values: list[str], count: int) -> tuple[str, ...]:
    if not rows:
        return ()
    column = [""] * count
    for row, value in zip(rows, values, strict=True):
        column[row] = value
    return tuple(column)


@dataclass(frozen=True, kw_only=True)
class View:
    """A way to look at pages: the script that reads them, and what makes its columns a Page."""

    reader: str
    decode: Callable[[Json], Page]
    emulation: tuple[tuple[str, dict[str, Any]], ...] = ()  # DevTools methods and parameters, called once in every tab
    first: tuple[str, ...] = ()  # scripts that go before all others

    @functools.cached_property
    def script(self) -> str:
        """The source that Chrome runs in every document before the page's own scripts."""
        names = (*self.first, *SCRIPTS)
        parts = [source(name) for name in names]
        parts.insert(names.index("frame"), f"const view = {self.reader};")
        codes = json.dumps({**keys.NAMED_KEYS, **keys.CHARACTER_CODES})
        head = f"(() => {{\nif ('giirlFrame' in window) return;\nconst KEY_CODES = {codes};\n"
        return head + "\n".join(parts) + "\n})();\n"


ROWS = View(reader="reading", decode=decode_page)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What page.js says; `page` is missing where no episode goes on, `goal` where none begins."""

    raw_reward: float
    done: bool
    page: Page | None
    goal: Goal | None
    reason: str  # for the reward, where the page gives one


def decode(words: Json, view: View = ROWS) -> Answer:
    """The answer in what a page said; ValueError or TypeError when it is none."""
    raw_reward, done, columns, utterance, *reason = words
    return Answer(
        raw_reward=float(raw_reward),
        done=bool(done),
        page=None if columns is None else view.decode(columns),
        goal=None if utterance is None else Goal(utterance),
        reason=str(reason[0]) if reason else "",
    )
