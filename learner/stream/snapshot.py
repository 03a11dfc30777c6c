"""What the ingest holds at one moment, on disk and back: accepted episodes, what was judged, and what became of it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from pydantic import ConfigDict, NonNegativeInt, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked

from giirl_core.types import Episode
from giirl_core.wire.messages import read_episodes, write_episodes

BOOKS, QUEUE = "actors.json", "queue.giirl"
STRICT = ConfigDict(extra="forbid", strict=True)


@checked(config=STRICT, frozen=True, slots=True, kw_only=True)
class ActorOffsets:
    """Which episodes of an actor have been judged: what a checkpoint remembers of it."""

    actor: str
    incarnation: NonNegativeInt
    low_watermark: NonNegativeInt  # every sequence below
    acked: tuple[NonNegativeInt, ...] = ()  # and these above it
    finished: NonNegativeInt = 0  # by the actor, as far as was known


@checked(config=STRICT, frozen=True, slots=True, kw_only=True)
class _Books:
    marks: tuple[ActorOffsets, ...]
    counts: dict[str, NonNegativeInt]


_BOOKS = TypeAdapter(_Books)


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestSnapshot:
    """What a checkpoint has to hold of the ingest: episodes accepted and not yet used, all marks and counts."""

    episodes: tuple[Episode, ...] = ()
    marks: tuple[ActorOffsets, ...] = ()
    counts: Mapping[str, int] = field(default_factory=dict)  # what became of how many in this history

    def save(self, folder: Path) -> None:
        write_episodes(folder / QUEUE, self.episodes)
        books = {"marks": [asdict(mark) for mark in self.marks], "counts": dict(self.counts)}
        (folder / BOOKS).write_text(json.dumps(books))

    @classmethod
    def load(cls, folder: Path) -> IngestSnapshot:
        """The inverse of `save`; ValueError where the files are none of ours."""
        try:
            books = _BOOKS.validate_json((folder / BOOKS).read_bytes())
        except ValidationError as error:
            first = error.errors()[0]
            raise ValueError(f"{folder / BOOKS} at {first['loc']}: {first['msg']}; wanted a whole checkpoint") from None
        return cls(episodes=tuple(read_episodes(folder / QUEUE)), marks=books.marks, counts=books.counts)
