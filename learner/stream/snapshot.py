"""A snapshot of the ingest that a checkpoint stores: queued episodes, per-actor offsets and episode counts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from pydantic import ConfigDict, NonNegativeInt, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass as checked

from giirl_core.types import Episode
from giirl_core.wire.messages import read_episodes, write_episodes

OFFSETS_FILE, QUEUE_FILE = "actors.json", "queue.giirl"
STRICT = ConfigDict(extra="forbid", strict=True)


@checked(config=STRICT, frozen=True, slots=True, kw_only=True)
class ActorOffsets:
    """Which episodes of one actor incarnation are acknowledged. Sequence numbers count its episodes from 0."""

    actor: str
    incarnation: NonNegativeInt
    low_watermark: NonNegativeInt  # every sequence number below is acknowledged
    acked: tuple[NonNegativeInt, ...] = ()  # acknowledged sequence numbers above the watermark
    finished: NonNegativeInt = 0  # episodes the actor was known to have finished


@checked(config=STRICT, frozen=True, slots=True, kw_only=True)
class _OffsetsFile:
    offsets: tuple[ActorOffsets, ...]
    counts: dict[str, NonNegativeInt]


_OFFSETS_FILE = TypeAdapter(_OffsetsFile)


@dataclass(frozen=True, slots=True, kw_only=True)
class IngestSnapshot:
    """The state of the ingest at one moment."""

    episodes: tuple[Episode, ...] = ()  # accepted, and not yet taken by the learner
    offsets: tuple[ActorOffsets, ...] = ()  # one per actor
    counts: Mapping[str, int] = field(default_factory=dict)  # "taken" or a drop reason -> episodes so far

    def save(self, folder: Path) -> None:
        """Write both files into `folder`."""
        write_episodes(folder / QUEUE_FILE, self.episodes)
        content = {"offsets": [asdict(offsets) for offsets in self.offsets], "counts": dict(self.counts)}
        (folder / OFFSETS_FILE).write_text(json.dumps(content), encoding="utf-8")

    @classmethod
    def load(cls, folder: Path) -> IngestSnapshot:
        """The inverse of `save`. Raises ValueError if a file is damaged."""
        path = folder / OFFSETS_FILE
        try:
            content = _OFFSETS_FILE.validate_json(path.read_bytes())
        except ValidationError as error:
            first = error.errors()[0]
            raise ValueError(f"{path} is damaged at {first['loc']}: {first['msg']}") from None
        return cls(episodes=tuple(read_episodes(folder / QUEUE_FILE)), offsets=content.offsets, counts=content.counts)
