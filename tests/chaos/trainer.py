"""A simulated learner: it takes batches, records their episodes and saves real checkpoints, but trains nothing."""

from __future__ import annotations

import signal
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from giirl_core.wire.transport import Keys
from learner.checkpoint import latest_checkpoint, save_checkpoint
from learner.stream.flow import IngestLimits
from learner.stream.ingest import Ingest
from learner.stream.snapshot import IngestSnapshot
from tests.chaos.crowd import VERSION_FILE

BATCH = 32
CHECKPOINT_EVERY = 50  # steps
TRAINED_FILE = "trained.npy"  # in a checkpoint: the ids of all episodes taken so far
WRITING_FILE = "writing"  # exists while a checkpoint is written
UPDATE_S_FILE = "slow"  # holds the duration of each update, in seconds
LIMITS = IngestLimits(credits=4, max_lag=8, max_bytes=32 << 20)


def train(folder: Path, port: int, *, batch: int = BATCH, host: str = "127.0.0.1", keys: Keys | None = None) -> None:
    """Resume from the latest checkpoint and run until SIGTERM; save at the end."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda signum, frame: stopped.append(signum))
    checkpoints = folder / "checkpoints"
    snapshot, trained, version = IngestSnapshot(), np.empty(0, np.int64), 0
    if (checkpoints / "latest").exists():
        latest = latest_checkpoint(checkpoints)
        snapshot, trained = IngestSnapshot.load(latest), np.load(latest / TRAINED_FILE)
        version = int(latest.name.split("-")[1])
    ids: list[int] = trained.tolist()
    (folder / WRITING_FILE).unlink(missing_ok=True)

    ingest = Ingest("chaos", lambda: version, host=host, port=port, limits=LIMITS, keys=keys, snapshot=snapshot)
    with closing(ingest):

        def save() -> None:
            current = ingest.snapshot()

            def write(partial: Path) -> None:
                (folder / WRITING_FILE).touch()
                current.save(partial)
                np.save(partial / TRAINED_FILE, np.array(ids, np.int64))

            save_checkpoint(checkpoints, version, write, keep=2)
            (folder / WRITING_FILE).unlink()
            ingest.commit(current)

        while not stopped:
            if ingest.wants_commit:
                save()
            try:
                episodes = ingest.take(batch, 0.1)
            except TimeoutError:
                continue
            ids += [episode.trajectory.seed for episode in episodes]
            version += 1
            write_version(folder, version)
            time.sleep(update_s(folder))
            if version % CHECKPOINT_EVERY == 0:
                save()
        save()


def write_version(folder: Path, version: int) -> None:
    """Atomic, but not synced to disk."""
    (folder / f".{VERSION_FILE}").write_text(str(version))
    (folder / f".{VERSION_FILE}").replace(folder / VERSION_FILE)


def update_s(folder: Path) -> float:
    path = folder / UPDATE_S_FILE
    return float(path.read_text() or 0) if path.exists() else 0.0
