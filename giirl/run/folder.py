"""The folder of a run: config, demonstrations, checkpoints, learning curve, result and metrics addresses."""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from giirl_core.config import Config
from giirl_core.config_file import dump_config, load_config
from giirl_core.files import atomic_write
from giirl_core.types import Episode
from giirl_core.weights import Weights
from giirl_core.wire.messages import read_episodes, write_episodes

RUNTIME_FILE = "runtime.json"  # in a checkpoint: where the runtime continues


class RunFolder:
    """The paths of a run's files, and reading and writing them."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config_file = path / "config.json"
        self.demonstrations = path / "demonstrations.giirl"
        self.checkpoints = path / "checkpoints"
        self.curve = path / "curve.jsonl"
        self.result = path / "result.json"
        self.targets = path / "prometheus.json"
        self.keys = path / "keys"
        self.wanted = path / "wanted_actors"
        self.identity_file = path / "identity"

    @classmethod
    def create(cls, config: Config, name: str) -> RunFolder:
        """A new folder with the resolved config in it; ValueError if it exists and is not empty."""
        path = Path(config.run or f"runs/{name}-{time.strftime('%Y%m%d-%H%M%S')}")
        folder = cls(path)
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise ValueError(f"{path} is not empty: choose another run=FOLDER, or --resume {path}")
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ValueError(f"cannot create the run folder {path}: {error.strerror}") from None
        folder.write(folder.config_file, dump_config(config))
        return folder

    @classmethod
    def open(cls, path: Path) -> tuple[RunFolder, Config]:
        """The folder of an earlier run, and its config; ValueError if it is none."""
        folder = cls(path)
        if not folder.config_file.is_file():
            raise ValueError(f"{path} is not a run: it has no {folder.config_file.name}")
        return folder, load_config(folder.config_file)

    def discard_unless_begun(self) -> None:
        """Undo `create` if the run failed before its first checkpoint, so that the same command can be repeated."""
        if not self.checkpoints.exists():
            for path in (
                self.config_file,
                self.demonstrations,
                self.targets,
                self.curve,
                self.keys,
                self.identity_file,
            ):
                path.unlink(missing_ok=True)
            if not any(self.path.iterdir()):
                self.path.rmdir()

    @property
    def identity(self) -> str:
        """A name that no other run has, even one in a folder of the same name. It is stored in the folder."""
        if not self.identity_file.exists():
            name = "".join(c for c in self.path.name if c.isascii() and (c.isalnum() or c in "-_"))
            self.write(self.identity_file, f"{name[:40]}-{secrets.token_hex(4)}")
        return self.identity_file.read_text()

    def write(self, path: Path, text: str) -> None:
        """Write a file atomically."""
        with atomic_write(path) as file:
            file.write(text.encode())

    def wanted_actors(self) -> int:
        """The number of actors that `giirl actors` asked for, 0 if it was never called."""
        text = self.wanted.read_text() if self.wanted.exists() else ""
        return int(text) if text.isdecimal() else 0

    def save_demonstrations(self, episodes: list[Episode]) -> None:
        write_episodes(self.demonstrations, episodes)

    def load_demonstrations(self) -> list[Episode]:
        return read_episodes(self.demonstrations)

    def append_curve(self, point: Mapping[str, Any]) -> None:
        """Append a point to the learning curve."""
        with self.curve.open("a") as file:
            file.write(json.dumps(point) + "\n")

    def points(self) -> list[dict[str, Any]]:
        """The points of the learning curve so far."""
        if not self.curve.exists():
            return []
        *lines, _ = self.curve.read_text().split("\n")  # a run that was killed may leave a truncated last line
        return [json.loads(line) for line in lines]

    def cut_curve(self, step: int) -> None:
        """Delete the points after `step`, which a resumed run will reach again."""
        kept = [point for point in self.points() if point["step"] <= step]
        self.write(self.curve, "".join(json.dumps(point) + "\n" for point in kept))

    def weights(self, checkpoint: Path, net: str) -> Weights:
        """The weights of a net ("policy" or "reward") in a checkpoint."""
        version = json.loads((checkpoint / "learner.json").read_text())["version"]
        return Weights.with_digest(version, (checkpoint / f"{net}.safetensors").read_bytes())
