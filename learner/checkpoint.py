"""Atomic checkpoints: written to a temporary folder, hashed, renamed into place, then named in the `latest` file."""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

from giirl_core.files import atomic_write, naming, sync, sync_folder

MANIFEST = "manifest.json"
LATEST = "latest"


def save_checkpoint(folder: Path, step: int, write: Callable[[Path], None], keep: int) -> Path:
    """Save a checkpoint for `step`, make it the latest, and delete all but the newest `keep`.

    `write` has to put all files of the checkpoint directly into the folder that it is called with. If it raises, or the
    disk is full, the latest checkpoint stays as it was. Returns the folder of the new checkpoint.
    """
    with naming(folder):
        folder.mkdir(parents=True, exist_ok=True)
        _delete(folder.glob(".partial-*"))
        final, partial = _free_name(folder, step), folder / f".partial-{step:08d}-{secrets.token_hex(4)}"
        partial.mkdir()
        try:
            write(partial)
            _seal(partial, step)
            if final.exists():  # left from before the run went back to an earlier checkpoint
                final.rename(folder / f"{partial.name}-old")
            partial.rename(final)
        except BaseException:
            _delete([partial])
            raise
        sync_folder(folder)
        with atomic_write(folder / LATEST) as file:
            file.write(final.name.encode())
    others = sorted(path for path in folder.glob("step-*") if path != final)  # may hold later steps, see above
    _delete([*others[: max(0, len(others) + 1 - keep)], *folder.glob(".partial-*")])
    return final


def has_checkpoint(folder: Path) -> bool:
    """Whether a checkpoint was ever completed in this folder; it may be damaged by now."""
    return (folder / LATEST).is_file() or bool(_complete(folder))


def latest_checkpoint(folder: Path) -> Path:
    """The folder of the latest checkpoint, verified against its hashes.

    Without the `latest` file it is the one with the highest step. Raises ValueError, in one line, if there is none, or
    if it is incomplete or damaged.
    """
    if not has_checkpoint(folder):
        raise ValueError(f"{folder} holds no checkpoint to resume from")
    pointer, found = folder / LATEST, folder / _latest_name(folder)
    if found.parent != folder or not (found / MANIFEST).is_file():
        raise ValueError(f"{pointer} names {found.name!r}, which is no complete checkpoint{_advice(folder, found)}")
    try:
        wanted: dict[str, str] = json.loads((found / MANIFEST).read_bytes())["sha256"]
        names = sorted(wanted.keys())
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{found / MANIFEST} is damaged: {error!r}{_advice(folder, found)}") from None
    for name in names:
        path = found / name
        if not path.is_file():
            raise ValueError(f"the checkpoint {found} is incomplete: {name} is missing{_advice(folder, found)}")
        if hashlib.sha256(path.read_bytes()).hexdigest() != wanted[name]:
            raise ValueError(
                f"the checkpoint {found} is damaged: the SHA-256 of {name} ({path.stat().st_size} bytes) is not the "
                f"one in {MANIFEST}{_advice(folder, found)}"
            )
    return found


def _free_name(folder: Path, step: int) -> Path:
    """The new checkpoint's folder, never that of the latest: when a step is saved twice, the first save stays valid."""
    name = f"step-{step:08d}"
    return folder / (f"{name}-again" if name == _latest_name(folder) else name)


def _advice(folder: Path, damaged: Path) -> str:
    """The end of an error message: how to resume from an older checkpoint."""
    others = [path.name for path in sorted(folder.glob("step-*")) if path != damaged]
    if not others:
        return "; there is no older checkpoint"
    return f"; to resume from an older checkpoint, write {others[-1]} into {folder / LATEST}"


def _latest_name(folder: Path) -> str:
    """What `latest` says; without that file the newest complete checkpoint; "" if there is none."""
    pointer = folder / LATEST
    if pointer.is_file():
        return pointer.read_text(encoding="utf-8").strip()
    return next((path.name for path in reversed(_complete(folder))), "")


def _complete(folder: Path) -> list[Path]:
    """All checkpoints that were written to their end, by step."""
    return sorted(manifest.parent for manifest in folder.glob(f"step-*/{MANIFEST}"))


def _seal(partial: Path, step: int) -> None:
    """Sync all files of a checkpoint to the disk, and write the manifest with their hashes."""
    hashes = {path.name: _sync_and_hash(path) for path in sorted(partial.iterdir())}
    manifest = partial / MANIFEST
    manifest.write_text(json.dumps({"step": step, "sha256": hashes}, indent=2), encoding="utf-8")
    _sync_and_hash(manifest)
    sync_folder(partial)


def _sync_and_hash(path: Path) -> str:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        sync(file.fileno(), path)
    return digest


def _delete(folders: Iterable[Path]) -> None:
    """Delete folders as far as the file system lets us; what remains is tried again with the next checkpoint."""
    for path in folders:
        shutil.rmtree(path, ignore_errors=True)
