"""Atomic writes of files, and exclusive locks on folders."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

LOCK_POLL_S = 0.2  # between two attempts to get a lock
OLD_S = 7 * 86400.0  # after which temporary files of a run are deleted


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """A binary file to write to; it replaces `path` atomically at the end of the block.

    The data is synced to the disk before the rename. An exception in the block leaves `path` as it was.
    """
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=f".{path.name}.", delete=False) as file:
        temporary = Path(file.name)
        try:
            yield file.file  # type: ignore[misc]
            file.flush()
            os.fsync(file.fileno())
            temporary.chmod(0o644)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    sync_folder(path.parent)


def user_folder() -> Path:
    """The folder for temporary files of this Unix user, which nobody else can read: /tmp/giirl-UID.

    Folders in it that nothing has changed for OLD_S are deleted. ValueError if another user owns it.
    """
    folder = Path(tempfile.gettempdir()) / f"giirl-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid():
        raise ValueError(f"{folder} belongs to user {status.st_uid}: remove it, or set TMPDIR to a folder of your own")
    folder.chmod(0o700)
    for old in folder.iterdir():
        if time.time() - max(path.lstat().st_mtime for path in (old, *old.rglob("*"))) > OLD_S:
            shutil.rmtree(old, ignore_errors=True)
    return folder


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON, atomically."""
    with atomic_write(path) as file:
        file.write(json.dumps(value, indent=2).encode() + b"\n")


def sync_folder(folder: Path) -> None:
    """Sync a folder to the disk, so that renames in it survive a power failure."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def is_locked(folder: Path) -> bool:
    """Whether a process holds the lock of a folder."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False


def open_files() -> set[Path]:
    """The files that processes of this Unix user on this machine have open."""
    found = set()
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):  # it has ended, or belongs to another user
            found.add(link.readlink())
    return found


@contextmanager
def folder_lock(folder: Path, *, timeout_s: float = 0.0) -> Iterator[None]:
    """Lock a folder for this process; the operating system releases the lock when the process ends.

    Raises ValueError when another process holds the lock for `timeout_s`.
    """
    handle, deadline_s = os.open(folder, os.O_RDONLY), time.monotonic() + timeout_s
    try:
        while True:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= deadline_s:
                    raise ValueError(f"another process uses {folder}: wait until it ends, or stop it") from None
                time.sleep(LOCK_POLL_S)
        yield
    finally:
        os.close(handle)
