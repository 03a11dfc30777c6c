"""Start a run or go on with it: the same command for a job and for every retry, after a kill at any moment."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from giirl.run.folder import RunFolder
from giirl_core.config import Config
from giirl_core.config_file import differences, dump_config
from giirl_core.files import folder_lock
from learner.checkpoint import LATEST, MANIFEST, latest_checkpoint

LOCK_TIMEOUT_S = 60.0  # for the try before this one, which may still save
RESUMABLE = ("iterations", "checkpoint_every", "keep_checkpoints", "evaluate.", "metrics.")  # settings


@contextmanager
def claimed(config: Config) -> Iterator[RunFolder]:
    """The folder of the run, made if it is missing, and locked in the `with` block.

    ValueError if the config names none, or if another process uses it for LOCK_TIMEOUT_S.
    """
    if not config.run:
        raise ValueError("--resume-or-start needs a folder that is the same in every try: add run=FOLDER")
    folder = RunFolder(Path(config.run))
    try:
        folder.path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(f"cannot create the run folder {folder.path}: {error.strerror}") from None
    with folder_lock(folder.path, timeout_s=LOCK_TIMEOUT_S):
        yield folder


def resume_or_start(folder: RunFolder, config: Config) -> Path | None:
    """The checkpoint to resume from; None if the run starts from nothing. The config is saved in the folder.

    ValueError if the folder holds a run with other settings, or files that are not of a run.
    """
    if not (folder.checkpoints / LATEST).is_file():
        _clear(folder)
        folder.write(folder.config_file, dump_config(config))
        return None
    _, saved = RunFolder.open(folder.path)
    changes = [key for key in differences(saved, config) if key != "run"]
    if fixed := [key for key in changes if not key.startswith(RESUMABLE)]:
        raise ValueError(
            f"{folder.path} is a run with another {fixed[0]}, wanted the same settings in every try: "
            f"choose another run=FOLDER, or give the settings in its {folder.config_file.name}"
        )
    checkpoint = latest_checkpoint(folder.checkpoints)
    if changes:
        folder.write(folder.config_file, dump_config(config))
    return checkpoint


def is_finished(folder: RunFolder, config: Config, checkpoint: Path | None) -> bool:
    """Whether the run has trained to its end and has a result."""
    if checkpoint is None or not folder.result.is_file():
        return False
    step: int = json.loads((checkpoint / MANIFEST).read_text())["step"]
    return step >= config.iterations


def _clear(folder: RunFolder) -> None:
    """Delete what a try without a checkpoint left. Its identity stays: processes of that try may still be there."""
    ours = {
        folder.config_file,
        folder.demonstrations,
        folder.targets,
        folder.curve,
        folder.keys,
        folder.identity_file,
        folder.checkpoints,
        folder.wanted,
        folder.path / "actors",
    }
    files = list(folder.path.iterdir())
    if foreign := sorted(path.name for path in files if path not in ours and not path.name.startswith(".")):
        raise ValueError(f"{folder.path} holds {foreign[0]}, which is of no run: choose another run=FOLDER")
    for path in files:
        if path.is_dir():
            shutil.rmtree(path)
        elif path not in (folder.identity_file, folder.keys):
            path.unlink()
