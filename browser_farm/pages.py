"""The protocol of page.js: encodes requests to it, and decodes its answers into pages and goals."""

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
GONE = "gone"  # the answer of a document without an open episode
WAIT = "wait"  # the answer of a page that is still loading: PENDING_ANSWER returns the real one
PENDING_ANSWER = "giirl.pendingAnswer()"
SCROLL_DRAWN = "giirl.scrollDrawn()"  # resolves once Chrome has drawn the effect of a mouse wheel event
Json = list[Any]
SCRIPTS = ("clock", "focus", "keyboard", "gestures", "attributes", "reading", "elements", "frame", "page")


def source(name: str) -> str:
    """The JavaScript source of one script of this package, named without its suffix."""
    return (Path(__file__).parent / "js" / f"{name}.js").read_text(encoding="utf-8")


def _begin(episode: EpisodeSpec) -> Json:
    """Seed and mode of an episode. The seed is text: JavaScript's numbers are exact to 2**53 only."""
    return [str(int(episode.seed)), episode.mode]


def start_call(episode: EpisodeSpec) -> Json:
    """Request to open an episode."""
    return [_begin(episode)]


def step_call(command: Command, task: str) -> Json:
    """Request to act, and to open the following episode in the same document if it has the same task."""
    following = command.following
    same_document = following is not None and following.task == task and not needs_fresh_document(task)
    next_episode = _begin(following) if following is not None and same_document else None
    return [_encode_action(command), command.last, next_episode]


def aim_call(command: Command) -> Json:
    """Request for the coordinates of an action's input events, see `trusted_input.events`."""
    return [_encode_action(command), True]


def _encode_action(command: Command) -> Json:
    return [int(command.verb), command.ref, command.text, *command.at, *command.by, command.to]


def decode_page(columns: list[Any]) -> Page:
    """A Page from the columns that reading.js returns."""
    tag, text, value, classes, numbers, boxes, details = columns
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
        colour=_dense_column(details[::4], details[1::4], len(tag)),
        shape=_dense_column(details[::4], details[2::4], len(tag)),
        attributes=_dense_column(details[::4], details[3::4], len(tag)),
    )


def _dense_column(rows: list[int], values: list[str], count: int) -> tuple[str, ...]:
    """[count] the values at their rows and "" elsewhere; () when there are none."""
    if not rows:
        return ()
    column = [""] * count
    for row, value in zip(rows, values, strict=True):
        column[row] = value
    return tuple(column)


@dataclass(frozen=True, kw_only=True)
class View:
    """How pages are observed: the script that reads them, and the decoder of its columns."""

    reader: str  # script that defines `reset`, `walk` and `nodeOf`
    decode: Callable[[Json], Page]
    emulation: tuple[tuple[str, dict[str, Any]], ...] = ()  # DevTools methods and parameters, called once in every tab
    first: tuple[str, ...] = ()  # scripts to run before all others
    real_time: bool = False  # pages keep their own clock, time limit and animations
    wait_ms: float = 0.0  # pause after each action, ms of the page's clock

    @functools.cached_property
    def script(self) -> str:
        """The source that Chrome runs in every document before the page's own scripts."""
        names = (*self.first, *SCRIPTS)
        parts = [source(name) for name in names]
        parts.insert(names.index("frame"), f"const view = {self.reader};")
        constants = {
            "KEY_CODES": {**keys.NAMED_KEYS, **keys.CHARACTER_CODES},
            "TYPED_KEYS": keys.TYPED_KEYS,
            "REAL_TIME": self.real_time,
            "WAIT_MS": self.wait_ms,
        }
        head = "".join(f"const {name} = {json.dumps(value)};\n" for name, value in constants.items())
        return f"(() => {{\nif ('giirlFrame' in window) return;\n{head}" + "\n".join(parts) + "\n})();\n"


ROWS = View(reader="reading", decode=decode_page)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """An answer of page.js. `page` is None when no episode continues, `goal` is None when none begins."""

    raw_reward: float
    done: bool
    page: Page | None
    goal: Goal | None
    reason: str  # for the reward, "" unless the page gives one
    scaled_reward: float | None = None  # reward scaled by the time that was left; None unless pages run in real time


def decode(answer: Json, view: View = ROWS) -> Answer:
    """Decode an answer of page.js; ValueError or TypeError when it is malformed."""
    raw_reward, done, columns, utterance, *end = answer
    return Answer(
        raw_reward=float(raw_reward),
        done=bool(done),
        page=None if columns is None else view.decode(columns),
        goal=None if utterance is None else Goal(utterance),
        reason=str(end[0]) if end else "",
        scaled_reward=float(end[1]) if len(end) > 1 else None,
    )
