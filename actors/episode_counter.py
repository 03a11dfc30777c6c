"""Counts the finished episodes of each incarnation of an actor, in a file, so that the counts survive a SIGKILL."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from giirl_core.files import naming, try_lock, unlock
from giirl_core.temporary import user_folder
from giirl_core.wire.delivery import MAX_EARLIER, IncarnationCounts

LOCK_TIMEOUT_S = 10.0  # an earlier incarnation that was suspended while it held the lock is killed within this time
LOCK_RETRY_S = 0.001
ENTRY = struct.Struct("<QQ")  # incarnation, episodes finished


class Replaced(RuntimeError):
    """A newer incarnation of this actor has taken over."""


def read_counts(path: Path) -> IncarnationCounts:
    """(incarnation, episodes finished) pairs in the file of an actor, which may be running; () without a file."""
    return tuple(sorted(dict(_entries(path.read_bytes())).items())) if path.exists() else ()


def counter_file(folder: Path | None, run: str, actor: str) -> Path:
    """Where an actor counts its episodes: in `folder`, or without one in a temporary folder of the node.

    ValueError if the temporary folder cannot be used.
    """
    return (folder or user_folder() / run) / f"{actor}.count"


def delete_counts(path: Path) -> None:
    """Delete the file of an actor, and its folder with the last file."""
    path.unlink(missing_ok=True)
    with suppress(OSError):  # other actors of the run have files in it
        path.parent.rmdir()


def _entries(data: bytes) -> Iterator[tuple[int, int]]:
    return ENTRY.iter_unpack(data[: len(data) // ENTRY.size * ENTRY.size])


class EpisodeCounter:
    """One entry per incarnation, in ascending order; the last one is ours. Each change takes a lock on the file.

    Written counts survive the death of the process, but not of the machine. A replaced incarnation cannot finish any
    more episodes, so the counts that its successor reads are final.
    """

    def __init__(self, path: Path, incarnation: int) -> None:
        """Raises Replaced if `incarnation` is not newer than all incarnations in the file."""
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._path, self._incarnation, self._finished = path, incarnation, 0
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            with self._locked():
                entries = dict(_entries(os.pread(self._file, os.fstat(self._file).st_size, 0)))
                if max(entries, default=-1) >= incarnation:
                    raise Replaced(f"{path} belongs to incarnation {max(entries)}, wanted one before {incarnation}")
                self.before: IncarnationCounts = tuple((i, n) for i, n in sorted(entries.items()) if n)[-MAX_EARLIER:]
                self._write([*self.before, (incarnation, 0)])
        except BaseException:
            os.close(self._file)
            raise

    def add(self) -> int:
        """Count one finished episode; returns its sequence number. Raises Replaced if a newer incarnation has begun."""
        with self._locked():
            self._check_newest()
            os.pwrite(self._file, ENTRY.pack(self._incarnation, self._finished + 1), self._offset())
        self._finished += 1
        return self._finished - 1

    def forget_before(self, incarnation: int) -> None:
        """Delete the counts of earlier incarnations, whose lost episodes are counted in a checkpoint."""
        kept = tuple((i, n) for i, n in self.before if i >= incarnation)
        if kept != self.before:
            with self._locked():
                self._check_newest()
                self.before = kept
                self._write([*kept, (self._incarnation, self._finished)])

    def close(self) -> None:
        os.close(self._file)

    def _offset(self) -> int:
        """The position of our entry in the file, in bytes."""
        return len(self.before) * ENTRY.size

    def _check_newest(self) -> None:
        newest, _ = ENTRY.unpack(os.pread(self._file, ENTRY.size, os.fstat(self._file).st_size - ENTRY.size))
        if newest != self._incarnation:
            raise Replaced(f"incarnation {newest} has taken over from {self._incarnation}")

    def _write(self, entries: list[tuple[int, int]]) -> None:
        """Replace the entries. A kill between the two calls leaves old entries at the end, which are duplicates."""
        data = b"".join(ENTRY.pack(*entry) for entry in entries)
        os.pwrite(self._file, data, 0)
        os.ftruncate(self._file, len(data))

    @contextmanager
    def _locked(self) -> Iterator[None]:
        deadline_s = time.monotonic() + LOCK_TIMEOUT_S
        while True:
            if try_lock(self._file, self._path):
                break
            if time.monotonic() > deadline_s:
                raise RuntimeError(f"another incarnation has locked the episode counter for {LOCK_TIMEOUT_S:.0f} s")
            time.sleep(LOCK_RETRY_S)
        try:
            with naming(self._path):
                yield
        finally:
            unlock(self._file)
