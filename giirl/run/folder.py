"""One run, one folder: config, demonstrations, checkpoints, curve, results and where to scrape it."""

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
from giirl_core.types import Episode, Weights
from giirl_core.wire.messages import read_episodes, write_episodes


class RunFolder:
    """Paths of a run and the files that are more than bytes."""

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
        """A new folder with the resolved config in it; ValueError when something is already there."""
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
        """An earlier run and its config."""
        folder = cls(path)
        if not folder.config_file.is_file():
            raise ValueError(f"{path} is no run: there is no {folder.config_file.name} in it")
        return folder, load_config(folder.config_file)

    def discard_unless_begun(self) -> None:
        """Take back `create` where a run failed before its first checkpoint: the mended command finds no folder."""
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
        """What tells this run from every other one, those in folders of the same name too."""
        if not self.identity_file.exists():
            name = "".join(c for c in self.path.name if c.isascii() and (c.isalnum() or c in "-_"))
            self.write(self.identity_file, f"{name[:40]}-{secrets.token_hex(4)}")
        return self.identity_file.read_text()

    def write(self, path: Path, text: str) -> None:
        """Replace a file whole."""
        with atomic_write(path) as file:
            file.write(text.encode())

    def wanted_actors(self) -> int:
        """How many actors were asked for since the run began, 0 when nobody asked."""
        text = self.wanted.read_text() if self.wanted.exists() else ""
        return int(text) if text.isdecimal() else 0

    def save_demonstrations(self, episodes: list[Episode]) -> None:
        write_episodes(self.demonstrations, episodes)

    def load_demonstrations(self) -> list[Episode]:
        return read_episodes(self.demonstrations)

    def append_curve(self, point: Mapping[str, Any]) -> None:
        """One line of the learning curve."""
        with self.curve.open("a") as file:
            file.write(json.dumps(point) + "\n")

    def points(self) -> list[dict[str, Any]]:
        """The learning curve so far."""
        if not self.curve.exists():
            return []
        *whole, _ = self.curve.read_text().split("\n")  # a run that was killed may leave a last line cut short
        return [json.loads(line) for line in whole]

    def cut_curve(self, step: int) -> None:
        """Forget what came after `step`: a resumed run lives through it again."""
        kept = [point for point in self.points() if point["step"] <= step]
        self.write(self.curve, "".join(json.dumps(point) + "\n" for point in kept))

    def weights(self, checkpoint: Path, net: str) -> Weights:
        """The weights of "policy" or "reward" in a checkpoint."""
        version = json.loads((checkpoint / "learner.json").read_text())["version"]
        return Weights.seal(version, (checkpoint / f"{net}.safetensors").read_bytes())
