"""A learner that learns nothing: takes batches, remembers what it took, saves real checkpoints, can be killed."""

from __future__ import annotations

import signal
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from giirl_core.wire.transport import Keys
from learner.checkpoint import latest_checkpoint, save_checkpoint
from learner.stream.admission import IngestLimits
from learner.stream.ingest import Ingest
from learner.stream.snapshot import IngestSnapshot
from tests.chaos.crowd import VERSION

BATCH = 32
EVERY = 50  # steps between checkpoints
TRAINED = "trained.npy"
WRITING = "writing"  # there while a checkpoint is written
SLOW = "slow"  # holds how long each update takes, seconds
LIMITS = IngestLimits(credits=4, max_lag=8, max_bytes=32 << 20)


def train(folder: Path, port: int, *, batch: int = BATCH, host: str = "127.0.0.1", keys: Keys | None = None) -> None:
    """Go on from the last checkpoint until SIGTERM; save at the end."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stopped.append(number))
    checkpoints = folder / "checkpoints"
    held, trained, version = IngestSnapshot(), np.empty(0, np.int64), 0
    if (checkpoints / "latest").exists():
        found = latest_checkpoint(checkpoints)
        held, trained = IngestSnapshot.load(found), np.load(found / TRAINED)
        version = int(found.name.split("-")[1])
    seeds: list[int] = trained.tolist()
    (folder / WRITING).unlink(missing_ok=True)

    with closing(Ingest("chaos", lambda: version, host=host, port=port, limits=LIMITS, keys=keys, held=held)) as ingest:

        def save() -> None:
            snapshot = ingest.snapshot()

            def write(partial: Path) -> None:
                (folder / WRITING).touch()
                snapshot.save(partial)
                np.save(partial / TRAINED, np.array(seeds, np.int64))

            save_checkpoint(checkpoints, version, write, keep=2)
            (folder / WRITING).unlink()
            ingest.committed(snapshot)

        while not stopped:
            if ingest.wants_commit:
                save()
            try:
                episodes = ingest.take(batch, 0.1)
            except TimeoutError:
                continue
            seeds += [episode.trajectory.seed for episode in episodes]
            version += 1
            tell_version(folder, version)
            time.sleep(pause_s(folder))
            if version % EVERY == 0:
                save()
        save()


def tell_version(folder: Path, version: int) -> None:
    """Whole or not at all, but not for a power cut."""
    (folder / f".{VERSION}").write_text(str(version))
    (folder / f".{VERSION}").replace(folder / VERSION)


def pause_s(folder: Path) -> float:
    path = folder / SLOW
    return float(path.read_text() or 0) if path.exists() else 0.0
