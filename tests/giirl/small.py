"""Runs that are small enough for a test: the fake browser, tiny nets, a few iterations, one thread."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from giirl.run.folder import RunFolder
from giirl.run.train import train
from giirl_core.config import Config
from giirl_core.config_file import load_config
from giirl_core.progress import Display

SETTINGS = (
    "runtime=serial",
    "browser=fake",
    "net.vectors=hashed",
    "net.width=16",
    "iterations=4",
    "rollout_batch=8",
    "step_limit=5",
    "checkpoint_every=2",
    "demos.per_task=4",
    "discriminator.batch=16",
    "policy.sampled_actions=4",
    "actors.tabs=4",
    "evaluate.episodes=4",
    "evaluate.random_episodes=4",
)


def config(path: Path, *changes: str) -> Config:
    """The small settings with changes."""
    return load_config(None, [*SETTINGS, *changes, f"run={path}"])


def run(path: Path, *changes: str, resume: Path | None = None) -> dict[str, Any]:
    """Train in this process and return the result; with `resume`, from that checkpoint of an earlier run."""
    if resume is not None:
        folder = RunFolder(path)
        return train(load_config(folder.config_file, [*changes, f"run={path}"]), folder, resume, Display())
    settings = config(path, *changes)
    return train(settings, RunFolder.create(settings, "test"), None, Display())
