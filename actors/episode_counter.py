"""How many episodes each incarnation of one actor has finished: a file, so that the count outlives a SIGKILL."""

from __future__ import annotations

import fcntl
import os
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from giirl_core.wire.delivery import MAX_EARLIER, IncarnationCounts

LOCK_S = 10.0  # for an incarnation that was stopped in the midst of counting to be ended
ENTRY = struct.Struct("<QQ")  # incarnation, episodes finished


class Replaced(RuntimeError):
    """A newer incarnation of this actor has taken over."""


def read_counts(path: Path) -> IncarnationCounts:
    """What the file of an actor that may be at work says: incarnations, and how much each finished."""
    return tuple(sorted(dict(_entries(path.read_bytes())).items())) if path.exists() else ()


def _entries(whole: bytes) -> Iterator[tuple[int, int]]:
    return ENTRY.iter_unpack(whole[: len(whole) // ENTRY.size * ENTRY.size])


class EpisodeCounter:
    """Entries in the order of their incarnations, the last of them ours, each change under a lock on the file.

    Killing a process loses nothing that was written; only the machine's own death does. A replaced incarnation can
    finish nothing any more, so what its successor reads here is final.
    """

    def __init__(self, path: Path, incarnation: int) -> None:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        self._incarnation, self._finished = incarnation, 0
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            with self._locked():
                entries = dict(_entries(os.pread(self._file, os.fstat(self._file).st_size, 0)))
                if max(entries, default=-1) >= incarnation:
                    raise Replaced(f"{path} is incarnation {max(entries)}'s, wanted one below {incarnation}")
                self.before: IncarnationCounts = tuple((i, n) for i, n in sorted(entries.items()) if n)[-MAX_EARLIER:]
                self._write([*self.before, (incarnation, 0)])
        except BaseException:
            os.close(self._file)
            raise

    def add(self) -> int:
        """One more is finished; returns its sequence number. Raises Replaced when a newer incarnation has begun."""
        with self._locked():
            self._check()
            os.pwrite(self._file, ENTRY.pack(self._incarnation, self._finished + 1), self._place())
        self._finished += 1
        return self._finished - 1

    def settle(self, incarnation: int) -> None:
        """Forget incarnations below: what they lost has been counted for good."""
        kept = tuple((i, n) for i, n in self.before if i >= incarnation)
        if kept != self.before:
            with self._locked():
                self._check()
                self.before = kept
                self._write([*kept, (self._incarnation, self._finished)])

    def close(self) -> None:
        os.close(self._file)

    def _place(self) -> int:
        return len(self.before) * ENTRY.size

    def _check(self) -> None:
        newest, _ = ENTRY.unpack(os.pread(self._file, ENTRY.size, os.fstat(self._file).st_size - ENTRY.size))
        if newest != self._incarnation:
            raise Replaced(f"incarnation {newest} has taken over from {self._incarnation}")

    def _write(self, entries: list[tuple[int, int]]) -> None:
        """A kill between the two calls leaves entries of before at the end: of incarnations that stand there twice."""
        blob = b"".join(ENTRY.pack(*entry) for entry in entries)
        os.pwrite(self._file, blob, 0)
        os.ftruncate(self._file, len(blob))

    @contextmanager
    def _locked(self) -> Iterator[None]:
        deadline_s = time.monotonic() + LOCK_S
        while True:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline_s:
                    raise RuntimeError(f"another incarnation has held the tally for {LOCK_S:.0f} s") from None
                time.sleep(0.001)
        try:
            yield
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)
