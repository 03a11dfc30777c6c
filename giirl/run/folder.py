"""The folder of a run: config, demonstrations, checkpoints, learning curve, result and metrics addresses."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from actors.episode_counter import read_counts
from giirl.run.states import CHECKPOINTS, CONFIG_FILE, check_free, make_folder
from giirl_core.config import Config
from giirl_core.config_file import dump_config, load_config
from giirl_core.files import atomic_write, check_writable, explain, folder_lock, naming
from giirl_core.types import Episode
from giirl_core.weights import Weights
from giirl_core.wire.messages import read_episodes, write_episodes
from learner.checkpoint import has_checkpoint, latest_checkpoint

RESERVED = 1 << 20  # incarnations of one session: more than its actors can ever use

RUNTIME_FILE = "runtime.json"  # in a checkpoint: where the runtime continues


class RunFolder:
    """The paths of a run's files, and reading and writing them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config_file = path / CONFIG_FILE
        self.demonstrations = path / "demonstrations.giirl"
        self.checkpoints = path / CHECKPOINTS
        self.curve = path / "curve.jsonl"
        self.result = path / "result.json"
        self.targets = path / "prometheus.json"
        self.keys = path / "keys"
        self.wanted = path / "wanted_actors"
        self.identity_file = path / "identity"
        self.incarnations = path / "incarnations"
        self.actors = path / "actors"
        self.feedback = path / "feedback"
        # What a run writes before its first checkpoint, without the config. Its identity stays when it begins again:
        # on a cluster, processes of the try before may still be there.
        self._identity_files = (self.keys, self.identity_file, self.incarnations)
        self._files = (self.demonstrations, self.curve, self.targets, self.wanted)
        self._held = False
        self._begun_with = ""  # the content of the config, if this process began the run

    @classmethod
    @contextmanager
    def started(cls, config: Config, name: str) -> Iterator[RunFolder]:
        """A new run in `config.run`, or in a new folder runs/NAME-TIME; no other process gets into it meanwhile.

        ValueError, which names the way out, when there is something in the folder that must not be lost.
        """
        folder = cls(make_folder(config.run, name))
        with folder.held():
            check_free(folder.path)
            folder.clear()
            folder._begun_with = dump_config(config)
            folder.save_config(config)
            yield folder

    @classmethod
    @contextmanager
    def resumed(cls, path: Path) -> Iterator[tuple[RunFolder, Config, Path | None]]:
        """An earlier run, its config and its latest checkpoint; None when it has none and begins again.

        No other process gets into it meanwhile. ValueError, which names the way out, when it cannot go on.
        """
        folder, _ = cls.open(path)
        with folder.held():
            check_writable(folder.config_file)
            _, config = cls.open(path)
            yield folder, config, folder.latest_checkpoint() if folder.saved else None

    @classmethod
    def create(cls, config: Config, name: str) -> RunFolder:
        """As `started`, for a process that trains later."""
        with cls.started(config, name) as folder:
            return folder

    @classmethod
    def open(cls, path: Path) -> tuple[RunFolder, Config]:
        """The folder of an earlier run, and its config; ValueError if it is none."""
        folder = cls(path)
        if not folder.config_file.is_file():
            raise ValueError(f"{path} is not a run: it has no {folder.config_file.name}")
        return folder, load_config(folder.config_file)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep other processes out of the folder in this block, which may be nested; ValueError if one is in there."""
        if self._held:
            yield
            return
        with folder_lock(self.path):
            if self._begun_with and not self.saved and self.config_file.read_text(encoding="utf-8") != self._begun_with:
                raise ValueError(f"another process began a run in {self.path}: choose another run=FOLDER")
            self._held = True
            try:
                yield
            finally:
                self._held = False

    @property
    def saved(self) -> bool:
        """Whether the run has a checkpoint. Before that there is nothing in the folder that cannot be made again."""
        return has_checkpoint(self.checkpoints)

    def clear(self) -> None:
        """Delete the run's files but its config, so that it can begin again. Nothing, if it has a checkpoint."""
        if self.saved:
            return
        for path in self._files:
            path.unlink(missing_ok=True)
        for path in (self.config_file, *self._files, *self._identity_files):
            for temporary in self.path.glob(f".{path.name}.*"):  # of a write that was cut off
                temporary.unlink()
        for folder in (self.checkpoints, self.actors):
            if folder.is_dir():
                shutil.rmtree(folder)

    def discard_unless_saved(self) -> None:
        """Leave nothing of a run that this process began and that failed before its first checkpoint."""
        if self._begun_with and not self.saved:
            with suppress(OSError):  # what stays does not hinder the next start
                self.clear()
                for path in (self.config_file, *self._identity_files):
                    path.unlink(missing_ok=True)
                self.path.rmdir()

    def latest_checkpoint(self) -> Path:
        """The latest checkpoint; ValueError, which says how to go on, if there is none or it is damaged."""
        if not self.saved:
            raise ValueError(f"{self.path} has no checkpoint yet; giirl train --resume {self.path} begins it again")
        try:
            return latest_checkpoint(self.checkpoints)
        except ValueError as error:
            raise ValueError(f"{error}; {self._anew}") from None

    @property
    def way_on(self) -> str:
        """The end of an error message: how to go on with the run. "" where the same command begins it again."""
        if not self.saved:
            return ""
        return f"; {self.latest_checkpoint().name} is saved, to resume: giirl train --resume {self.path}"

    @property
    def _anew(self) -> str:
        return f"to begin the run anew elsewhere: giirl train {self.config_file} run=NEW"

    @property
    def identity(self) -> str:
        """A name that no other run has, even one in a folder of the same name. It is stored in the folder."""
        if not _read(self.identity_file):
            name = "".join(c for c in self.path.name if c.isascii() and (c.isalnum() or c in "-_"))
            self.write(self.identity_file, f"{name[:40]}-{secrets.token_hex(4)}")
        return _read(self.identity_file)

    def reserve_incarnations(self, above: int) -> int:
        """A number from which on the next RESERVED are free for the actors of this session, also on other machines.

        It is above `above` and above all numbers of earlier sessions, whatever the clock says.
        """
        counted = [number for path in self.actors.glob("*.count") for number, _ in read_counts(path)]
        first = max(above, _number(self.incarnations), *counted) + 1
        self.write(self.incarnations, str(first + RESERVED))
        return first

    def save_config(self, config: Config) -> None:
        """Replace the config."""
        text = dump_config(config)
        self.write(self.config_file, text)
        if self._begun_with:
            self._begun_with = text

    def write(self, path: Path, text: str) -> None:
        """Write a file atomically."""
        with atomic_write(path) as file:
            file.write(text.encode())

    def wanted_actors(self) -> int:
        """The number of actors that `giirl actors` asked for, 0 if it was never called."""
        return _number(self.wanted)

    def save_demonstrations(self, episodes: list[Episode]) -> None:
        write_episodes(self.demonstrations, episodes)

    def load_demonstrations(self) -> list[Episode]:
        """The demonstrations; ValueError, which says how to go on, if the file is missing or damaged."""
        try:
            return read_episodes(self.demonstrations)
        except OSError as error:
            raise ValueError(f"{explain(error)}; put it back, or {self._anew}") from None
        except ValueError as error:
            raise ValueError(f"{error}; {self._anew}") from None

    def append_curve(self, point: Mapping[str, Any]) -> None:
        """Append a point to the learning curve."""
        with naming(self.curve), self.curve.open("a", encoding="utf-8") as file:
            file.write(json.dumps(point) + "\n")

    def points(self) -> list[dict[str, Any]]:
        """The points of the learning curve so far, without lines that a kill or a power failure left unreadable."""
        if not self.curve.exists():
            return []
        *lines, _ = self.curve.read_bytes().split(b"\n")
        points = []
        for line in lines:
            with suppress(ValueError):
                points.append(json.loads(line))
        return [point for point in points if isinstance(point, dict) and "step" in point]

    def cut_curve(self, step: int) -> None:
        """Delete the points after `step`, which a resumed run will reach again."""
        kept = [point for point in self.points() if point["step"] <= step]
        self.write(self.curve, "".join(json.dumps(point) + "\n" for point in kept))

    def weights(self, checkpoint: Path, net: str) -> Weights:
        """The weights of a net ("policy" or "reward") in a checkpoint."""
        version = json.loads((checkpoint / "learner.json").read_bytes())["version"]
        return Weights.with_digest(version, (checkpoint / f"{net}.safetensors").read_bytes())


def _read(path: Path) -> str:
    """The text of a file, "" if there is none."""
    return path.read_text(encoding="utf-8") if path.exists() else ""


def _number(path: Path) -> int:
    """The number in a file, 0 if there is none."""
    text = _read(path)
    return int(text) if text.isdecimal() else 0
