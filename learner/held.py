"""What the ingest holds at one moment, on disk and back: accepted episodes, and what has been judged of each actor."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from giirl.spec import Episode
from giirl.wire import read_episodes, write_episodes

MARKS, QUEUE = "actors.json", "queue.giirl"


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Which episodes of an actor have been judged: what a checkpoint remembers of it."""

    actor: str
    incarnation: int
    floor: int  # every sequence below
    judged: tuple[int, ...] = ()  # and these above it


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """What a checkpoint has to hold of the ingest: episodes accepted and not yet used, and all marks."""

    episodes: tuple[Episode, ...] = ()
    marks: tuple[Mark, ...] = ()

    def save(self, folder: Path) -> None:
        write_episodes(folder / QUEUE, self.episodes)
        (folder / MARKS).write_text(json.dumps([asdict(mark) for mark in self.marks]))

    @classmethod
    def load(cls, folder: Path) -> Held:
        marks = json.loads((folder / MARKS).read_text())
        return cls(
            episodes=tuple(read_episodes(folder / QUEUE)),
            marks=tuple(Mark(**{**mark, "judged": tuple(mark["judged"])}) for mark in marks),
        )
