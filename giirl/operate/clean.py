"""`giirl clean`: end processes on a Ray cluster whose learner is gone, and delete temporary folders of dead runs."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from pathlib import Path

from giirl.run.folder import RunFolder
from giirl_core.files import is_locked
from giirl_core.temporary import open_files, user_folder

UNCHANGED_S = 60.0  # in a container, the processes that have a file open may be invisible


def clean_up(runs: Sequence[Path], *, dry_run: bool) -> list[str]:
    """Remove what dead runs left; only those of `runs`, if there are any. Returns a line for each thing removed.

    ValueError if one of `runs` is no run, or is under way.
    """
    wanted = {}
    for path in runs:
        folder, _ = RunFolder.open(path)
        if is_locked(path):
            raise ValueError(f"{path} is under way: giirl stop {path} first")
        wanted[folder.identity] = folder
    found = _clean_cluster(set(wanted), dry_run=dry_run)
    found += _clean_temporary(set(wanted), dry_run=dry_run)
    for folder in wanted.values():
        for path in [*folder.checkpoints.glob(".partial-*"), *folder.path.glob(".*"), folder.path / "stop"]:
            if path.exists():
                found.append(str(path))
                if not dry_run:
                    _delete(path)
    return found


def _clean_cluster(identities: set[str], *, dry_run: bool) -> list[str]:
    """Kill the processes of dead runs on the cluster that this machine belongs to, if it belongs to one."""
    try:
        from giirl_core.processes.ray_platform import kill_left
    except ModuleNotFoundError:
        return []
    return kill_left(identities, dry_run=dry_run)


def _clean_temporary(identities: set[str], *, dry_run: bool) -> list[str]:
    """Delete the folders of runs in which no process has a file open, and that nothing has changed of late."""
    used = {path for path in open_files() if path.is_relative_to(user_folder())}
    found = []
    for folder in sorted(user_folder().iterdir()):
        if identities and folder.name not in identities:
            continue
        unchanged_s = time.time() - max(path.stat().st_mtime for path in (folder, *folder.rglob("*")))
        if not any(path.is_relative_to(folder) for path in used) and (identities or unchanged_s > UNCHANGED_S):
            found.append(str(folder))
            if not dry_run:
                _delete(folder)
    return found


def _delete(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
