"""What the folder of a run can hold, and what starting (`RunFolder.started`) and resuming (`resumed`) make of it.

| state | what is there | starting | resuming |
|-|-|-|-|
| FREE | nothing, or an empty folder | begins | refuses: no run |
| UNSAVED | a run that ended before its first checkpoint | begins again | begins again, with its own config |
| SAVED | a run with a checkpoint | refuses and names `--resume` | goes on |
| FOREIGN | something else | refuses and names `run=` | refuses: no run |
"""

from __future__ import annotations

import time
from enum import Enum
from itertools import count
from pathlib import Path

from giirl_core.config_file import dump_config, load_config
from giirl_core.files import explain
from learner.checkpoint import has_checkpoint

CONFIG_FILE, CHECKPOINTS = "config.json", "checkpoints"
RUNS = Path("runs")  # where runs are whose folder is not given


class State(Enum):
    """The state of a run's folder, see above."""

    FREE = "free"
    UNSAVED = "unsaved"
    SAVED = "saved"
    FOREIGN = "foreign"


def state_of(path: Path) -> State:
    """The state of a folder, which need not exist."""
    if not path.exists():
        return State.FREE
    if not path.is_dir():
        return State.FOREIGN
    if has_checkpoint(path / CHECKPOINTS):
        return State.SAVED
    cut_off = f".{CONFIG_FILE}."  # what remains of a start that was killed while it wrote its first file
    # The entries come first: another process may write its config, which is its first file, at this moment.
    if all(entry.name.startswith(cut_off) for entry in path.iterdir()):
        return State.FREE
    return State.UNSAVED if _wrote(path / CONFIG_FILE) else State.FOREIGN


def check_free(path: Path) -> None:
    """ValueError, which names the way out, if there is something in the folder that a new run must not replace."""
    other = f"{path} is not empty: choose another run=FOLDER"
    match state_of(path):
        case State.SAVED:
            raise ValueError(f"{other}, or go on with the run in it: giirl train --resume {path}")
        case State.FOREIGN:
            raise ValueError(f"{path} is a file: choose another run=FOLDER" if path.is_file() else other)


def make_folder(given: str, name: str) -> Path:
    """The folder `given`, or else a new one in runs/, which no other process gets, even in the same second."""
    try:
        if given:
            check_free(Path(given))
            Path(given).mkdir(parents=True, exist_ok=True)
            return Path(given)
        RUNS.mkdir(exist_ok=True)
        return _next_free(f"{name}-{time.strftime('%Y%m%d-%H%M%S')}")
    except OSError as error:
        raise ValueError(f"cannot create the run folder {explain(error)}") from None


def _next_free(name: str) -> Path:
    for number in count(1):
        path = RUNS / (name if number == 1 else f"{name}-{number}")
        try:
            path.mkdir()
        except FileExistsError:
            continue
        return path
    raise AssertionError


def _wrote(config_file: Path) -> bool:
    """Whether a run wrote this config. One that a person wrote is never replaced: it is not the same to the letter."""
    try:
        return dump_config(load_config(config_file)) == config_file.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
