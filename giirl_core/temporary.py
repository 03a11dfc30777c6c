"""The folder for temporary files of a Unix user, and which files are in use."""

from __future__ import annotations

import os
import shutil
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path

OLD_S = 7 * 86400.0  # after which temporary files of a run are deleted


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
        with suppress(FileNotFoundError):  # another process deletes it too
            if time.time() - max(path.lstat().st_mtime for path in (old, *old.rglob("*"))) > OLD_S:
                shutil.rmtree(old, ignore_errors=True)
    return folder


def open_files() -> set[Path]:
    """The files that processes of this Unix user on this machine have open."""
    found = set()
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):  # it has ended, or belongs to another user
            found.add(link.readlink())
    return found
