"""Speaks with page.js: writes its calls, and turns its replies into pages and goals."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from browser_farm.miniwob import needs_fresh_document
from giirl import keys
from giirl.spec import Command, EpisodeSpec, Goal, Page

FOCUSED = 1
TAMPERED = 2
GONE = "gone"  # what a document without an open episode answers
WAIT = "wait"  # the page is still loading: LATER has the answer
LATER = "giirl.later()"
SCRIPTS = ("keyboard", "gestures", "reading", "page")


@functools.cache
def script() -> str:
    """The source that Chrome runs in every document before the page's own scripts."""
    here = Path(__file__)
    parts = [here.with_name(f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS]
    codes = json.dumps({**keys.NAMED, **keys.CODES})
    return f"(() => {{\nconst KEY_CODES = {codes};\n" + "\n".join(parts) + "\n})();\n"


def start_call(episode: EpisodeSpec) -> str:
    return f"giirl.begin({episode.seed})"


def step_call(command: Command, task: str) -> str:
    """Act, and go on in the same document when the episode that follows has the same task."""
    following = command.following
    stays = following is not None and following.task == task and not needs_fresh_document(task)
    seed = following.seed if following is not None and stays else None
    action = [int(command.verb), command.ref, command.text, *command.at, *command.by, command.to]
    step = f"giirl.step({json.dumps(action)},{json.dumps(command.last)},{json.dumps(seed)})"
    return f"window.giirl&&giirl.isOpen()?{step}:'{GONE}'"


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What page.js says; `page` is missing where no episode goes on, `goal` where none begins."""

    raw_reward: float
    done: bool
    page: Page | None
    goal: Goal | None


def decode(text: str) -> Answer:
    """The answer in `text`; ValueError when it is none."""
    raw_reward, done, columns, utterance = json.loads(text)
    return Answer(
        raw_reward=float(raw_reward),
        done=bool(done),
        page=None if columns is None else decode_page(columns),
        goal=None if utterance is None else Goal(utterance),
    )


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
        colour=_scattered(looks[::3], looks[1::3], len(tag)),
        shape=_scattered(looks[::3], looks[2::3], len(tag)),
    )


def _scattered(rows: list[int], values: list[str], count: int) -> tuple[str, ...]:
    if not rows:
        return ()
    column = [""] * count
    for row, value in zip(rows, values, strict=True):
        column[row] = value
    return tuple(column)
