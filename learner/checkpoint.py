"""Checkpoints that are whole or not there: written aside, hashed, renamed, then pointed at."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

from giirl_core.files import atomic_write, sync_folder

MANIFEST = "manifest.json"
LATEST = "latest"


def save_checkpoint(folder: Path, step: int, write: Callable[[Path], None], keep: int) -> Path:
    """Let `write` fill a checkpoint for `step`, make it the latest, and prune all but the newest `keep`."""
    folder.mkdir(parents=True, exist_ok=True)
    final, partial = _free_name(folder, step), folder / f".partial-{step:08d}"
    for abandoned in folder.glob(".partial-*"):
        shutil.rmtree(abandoned)
    partial.mkdir()
    write(partial)
    hashes = {path.name: _sync_and_hash(path) for path in sorted(partial.iterdir())}
    manifest = partial / MANIFEST
    manifest.write_text(json.dumps({"step": step, "sha256": hashes}, indent=2))
    _sync_and_hash(manifest)
    sync_folder(partial)
    if final.exists():  # of a future that was given up by going back
        final.rename(folder / f".partial-{step:08d}-old")
    partial.rename(final)
    sync_folder(folder)
    with atomic_write(folder / LATEST) as file:
        file.write(final.name.encode())
    others = sorted(path for path in folder.glob("step-*") if path != final)  # later ones too, after going back
    for old in [*others[: max(0, len(others) + 1 - keep)], *folder.glob(".partial-*")]:
        shutil.rmtree(old)
    return final


def latest_checkpoint(folder: Path) -> Path:
    """The checkpoint to resume from, complete and unchanged; ValueError, one line, when there is none."""
    pointer = folder / LATEST
    if not pointer.is_file():
        raise ValueError(f"{folder} holds no checkpoint to resume from")
    found = folder / pointer.read_text().strip()
    if found.parent != folder or not (found / MANIFEST).is_file():
        raise ValueError(f"{pointer} names {found.name!r}, which is no complete checkpoint{_instead(folder, found)}")
    try:
        wanted: dict[str, str] = json.loads((found / MANIFEST).read_text())["sha256"]
        names = sorted(wanted.keys())
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{found / MANIFEST} is damaged: {error!r}{_instead(folder, found)}") from None
    for name in names:
        path = found / name
        if not path.is_file():
            raise ValueError(f"the checkpoint {found} is incomplete: {name} is missing{_instead(folder, found)}")
        if hashlib.sha256(path.read_bytes()).hexdigest() != wanted[name]:
            size = path.stat().st_size
            raise ValueError(
                f"the checkpoint {found} is damaged: {name}, now {size} bytes, is not what was saved"
                f"{_instead(folder, found)}"
            )
    return found


def _free_name(folder: Path, step: int) -> Path:
    """A name that is not the latest's: of a step saved twice the first stays whole until the second is."""
    pointer = folder / LATEST
    latest = pointer.read_text().strip() if pointer.is_file() else ""
    name = f"step-{step:08d}"
    return folder / (f"{name}-again" if latest == name else name)


def _instead(folder: Path, damaged: Path) -> str:
    """What a person can do about it."""
    others = [path.name for path in sorted(folder.glob("step-*")) if path != damaged]
    if not others:
        return "; there is no older one"
    return f"; to resume from an older one write {others[-1]} into {folder / LATEST}"


def _sync_and_hash(path: Path) -> str:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        os.fsync(file.fileno())
    return digest
