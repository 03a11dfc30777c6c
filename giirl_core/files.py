"""Files and folders: atomic writes, exclusive locks, and errors of the operating system in plain words."""

from __future__ import annotations

import errno
import fcntl
import json
import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO

MAX_TEMPORARY_LENGTH = 30  # characters; Chrome and Ray add about 75, and the path of a Unix socket holds 107
LOG = logging.getLogger(__name__)
PROBE_BYTES = 4096  # written to find out whether a disk has room
NOT_ON_DISK = (errno.EIO, errno.ENOSPC, errno.EDQUOT)  # errors of fsync that mean that the data is not on the disk
_SPACE = "free some space there, or choose another folder"
_PERMISSION = "choose a place that you may use, or change its permissions"
MENDS = {
    errno.ENOSPC: _SPACE,
    errno.EDQUOT: _SPACE,
    errno.EROFS: "choose a folder that can be written",
    errno.EACCES: _PERMISSION,
    errno.EPERM: _PERMISSION,
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EMFILE: "raise the limit of open files: ulimit -n 4096",
    errno.ENFILE: "raise the system's limit of open files: sysctl fs.file-max",
    errno.EIO: "look into the disk's own errors: dmesg",
    errno.ESTALE: "mount the folder again",
    errno.ENOMEM: "end other processes, or use fewer actors and tabs",
    errno.EADDRINUSE: "choose another port, or 0 for any free one",
}


def explain(error: Exception) -> str:
    """What failed. An error of the operating system without its number, with the place and how to mend it."""
    if not isinstance(error, OSError):
        return str(error)
    place = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
    mend = MENDS.get(error.errno or 0)
    return f"{place}{error.strerror or error}" + (f"; {mend}" if mend else "")


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """An error of the operating system in the block names `path`, not a temporary file or nothing at all."""
    try:
        yield
    except OSError as error:
        if error.errno is None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def atomic_write(path: Path, mode: int = 0o644) -> Iterator[BinaryIO]:
    """A binary file to write to; it replaces `path` atomically at the end of the block.

    The data is synced to the disk before the rename. An exception in the block leaves `path` as it was. A symbolic link
    stays, and what it points to is replaced. What is no file, as a pipe or /dev/null, is written to as it is.
    """
    target = path.resolve()
    with naming(path):
        if target.exists() and not target.is_file():
            with target.open("wb") as stream:
                yield stream
            return
        with _temporary_file(target) as file:
            temporary = Path(file.name)
            try:
                yield file.file
                file.flush()
                sync(file.fileno(), path)
                with suppress(OSError):  # some file systems have no permissions
                    temporary.chmod(mode)
                temporary.replace(target)
            except BaseException:
                temporary.unlink(missing_ok=True)
                raise
    sync_folder(target.parent)


def _temporary_file(target: Path) -> Any:
    return tempfile.NamedTemporaryFile(dir=target.parent, prefix=f".{target.name}.", delete=False)


def check_writable(path: Path) -> None:
    """Raise OSError, with the path, if `atomic_write` cannot write there: no permission, no space, a name too long."""
    target = path.resolve()
    with naming(path):
        if target.exists() and not target.is_file():
            if target.is_dir() or not os.access(target, os.W_OK):
                raise PermissionError(errno.EACCES, "cannot be written to")
            return
        with _temporary_file(target) as file:
            try:
                file.write(bytes(PROBE_BYTES))
                file.flush()
            finally:
                Path(file.name).unlink()


def writable(path: str | Path) -> Path:
    """The path; ValueError, before any work, if no file can be written there."""
    path = Path(path)
    if path.is_dir() or not path.absolute().parent.is_dir():
        raise ValueError(f"cannot write {path}: wanted a file in a folder that exists")
    try:
        check_writable(path)
    except OSError as error:
        raise ValueError(f"cannot write {explain(error)}") from None
    return path


def write_json(path: Path, value: Any) -> None:
    """Write `value` as indented JSON, atomically."""
    with atomic_write(path) as file:
        file.write(json.dumps(value, indent=2).encode() + b"\n")


def sync(file: int, path: Path) -> None:
    """Sync an open file or folder to the disk. Where the file system cannot, that is a warning."""
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno in NOT_ON_DISK:
            raise OSError(error.errno, error.strerror, str(path)) from error
        kind = "folders" if path.is_dir() else "files"
        _warn(
            f"{kind} in {path.parent} cannot be synced to the disk ({error.strerror}): "
            "the newest may be lost when the power fails"
        )


def sync_folder(folder: Path) -> None:
    """Sync a folder to the disk, so that renames in it survive a power failure."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        sync(handle, folder)
    finally:
        os.close(handle)


def is_locked(folder: Path) -> bool:
    """Whether a process holds the lock of a folder; False on a disk without locks."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    finally:
        os.close(handle)
    return False


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Lock a folder for this process; the operating system releases the lock when the process ends.

    Raises ValueError when another process holds the lock, or has just removed the folder.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        if not try_lock(handle, folder):
            raise ValueError(f"another process uses {folder}: wait until it ends, or stop it")
        if not folder.exists() or not os.path.samestat(os.fstat(handle), folder.stat()):
            raise ValueError(f"another process has just removed {folder}: try again")
        yield
    finally:
        os.close(handle)


def short_temporary_folder(wanted: str | None = None) -> str:
    """The folder `wanted`, by default that for temporary files, or /tmp where paths of sockets in it were too long."""
    folder = wanted or tempfile.gettempdir()
    return folder if len(folder) <= MAX_TEMPORARY_LENGTH else "/tmp"


def try_lock(file: int, path: Path) -> bool:
    """Lock an open file or folder; False when another process holds the lock. Without locks there: a warning, True."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        _warn(f"{path} cannot be locked ({error.strerror}): take care that no two processes use it")
    return True


def unlock(file: int) -> None:
    """Release the lock of `try_lock`."""
    with suppress(OSError):  # where there are no locks
        fcntl.flock(file, fcntl.LOCK_UN)


@cache
def _warn(text: str) -> None:
    """Log a warning once."""
    LOG.warning(text)
