"""Start a run or go on with it: the same command for a job and for every retry, after a kill at any moment."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from giirl.run.folder import RunFolder
from giirl.run.states import State, state_of
from giirl_core.config import Config
from giirl_core.config.sections import SHOWN
from giirl_core.config_file import differences
from giirl_core.files import is_locked
from learner.checkpoint import MANIFEST

LOCK_TIMEOUT_S = 60.0  # for the try before this one, which may still save
LOCK_POLL_S = 0.2
RESUMABLE = ("iterations", "checkpoint_every", "keep_checkpoints", "evaluate.", "metrics.")  # settings


@contextmanager
def resumed_or_started(config: Config) -> Iterator[tuple[RunFolder, Config, Path | None]]:
    """The folder of the run, its config and the checkpoint to go on from; None if the run begins, or begins again.

    No other process gets into it meanwhile. ValueError, which names the way out, if the config names no folder, or one
    with a run of other settings, with other files, or in use for LOCK_TIMEOUT_S.
    """
    if not config.run:
        raise ValueError("--resume-or-start needs a folder that is the same in every try: add run=FOLDER")
    path = Path(config.run)
    _wait_until_free(path)
    if state_of(path) is not State.SAVED:
        with RunFolder.started(config, "") as folder:
            yield folder, config, None
        return
    with RunFolder.resumed(path) as (folder, saved, checkpoint):
        if SHOWN in config.net.gestures:
            config = replace(config, net=replace(config.net, gestures=saved.net.gestures))
        if SHOWN in config.demos.workflows:
            config = replace(config, demos=replace(config.demos, workflows=saved.demos.workflows))
        changes = [key for key in differences(saved, config) if key != "run"]
        if fixed := [key for key in changes if not key.startswith(RESUMABLE)]:
            raise ValueError(
                f"{path} is a run with another {fixed[0]}, wanted the same settings in every try: "
                f"choose another run=FOLDER, or give the settings in its {folder.config_file.name}"
            )
        if changes:
            folder.save_config(config)
        yield folder, config, checkpoint


def is_finished(folder: RunFolder, config: Config, checkpoint: Path | None) -> bool:
    """Whether the run has trained to its end and has a result."""
    if checkpoint is None or not folder.result.is_file():
        return False
    step: int = json.loads((checkpoint / MANIFEST).read_bytes())["step"]
    return step >= config.iterations


def _wait_until_free(path: Path) -> None:
    """Wait until no other process uses the folder, at most LOCK_TIMEOUT_S. Who locks it says so if one still does."""
    deadline_s = time.monotonic() + LOCK_TIMEOUT_S
    while path.is_dir() and is_locked(path) and time.monotonic() < deadline_s:
        time.sleep(LOCK_POLL_S)
