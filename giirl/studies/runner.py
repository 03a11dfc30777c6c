"""Many runs from a few settings: each a `giirl train` of its own, never done twice, resumed where it broke off."""

from __future__ import annotations

import hashlib
import importlib.metadata
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from giirl.run.folder import RunFolder
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.config_file import dump_config, load_config
from giirl_core.files import write_json
from giirl_core.progress import Display
from learner.checkpoint import LATEST, latest_checkpoint

POLL_S = 1.0
VERSION = importlib.metadata.version("giirl")
REWARD_EVAL = "reward_eval.json"  # in a run's folder: what its reward answered
TRANSFER = "transfer.json"
GOAL_SWAP_TASK, GOAL_SWAP_PAGES = "click-button", 500
STOP_S = 60.0  # for a run that was told to stop, to save and end


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One way to run: settings by key=value. With `reward_of` it trains on the reward of that variant's same seed.

    `elsewhere` are tasks that its policy never saw, and is measured on all the same.
    """

    name: str
    changes: tuple[str, ...] = ()
    reward_of: str = ""
    transfer_tasks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """One run of a study: its folder is named after its settings and the version of GIIRL."""

    variant: Variant
    seed: int
    config: Config
    folder: Path

    @property
    def done(self) -> bool:
        return RunFolder(self.folder).result.is_file()


def plan(base: Sequence[str], variants: Sequence[Variant], seeds: Sequence[int], root: Path) -> list[Planned]:
    """Every run of a study, those that need another's reward behind it. ValueError for a setting that is none."""
    planned: dict[tuple[str, int], Planned] = {}
    for variant in variants:
        for seed in seeds:
            changes = [*base, *variant.changes, f"seed={seed}"]
            if variant.reward_of:
                changes += ["algorithm=frozen", f"reward_from={planned[variant.reward_of, seed].folder}"]
            config = load_config(None, changes)
            key = hashlib.sha256(f"{VERSION}\n{dump_config(config)}".encode()).hexdigest()[:12]
            planned[variant.name, seed] = Planned(variant=variant, seed=seed, config=config, folder=root / key)
    return list(planned.values())


def run_all(runs: Sequence[Planned], *, jobs: int, display: Display) -> None:
    """Do those that are not done, `jobs` at a time; RuntimeError, with all others done, when some failed.

    Ctrl-C lets each save first; the same command goes on from there.
    """
    waiting = list({run.folder: run for run in runs if not run.done}.values())
    children: list[_Child] = []
    failed: list[str] = []
    with display.job(f"{len(waiting)} runs", sum(run.config.iterations for run in waiting)) as job:
        try:
            while waiting or children:
                for run in _ready(waiting)[: jobs - len(children)]:
                    waiting.remove(run)
                    children.append(_Child(run))
                time.sleep(POLL_S)
                for child in list(children):
                    job.advance(child.progress(), child.name)
                    if child.process.poll() is None:
                        continue
                    children.remove(child)
                    if not child.run.done:
                        failed.append(f"{child.name}: {child.last_words()}")
                        waiting = [run for run in waiting if run.config.reward_from != str(child.run.folder)]
        finally:
            _stop(children)
    if failed:
        raise RuntimeError(f"{len(failed)} runs failed, the first of them {failed[0]}; the same command tries again")


def _ready(waiting: Sequence[Planned]) -> list[Planned]:
    """Those whose reward, if they follow another run's, has been learned."""
    return [run for run in waiting if not (of := run.config.reward_from) or RunFolder(Path(of)).result.is_file()]


class _Child:
    """A run under way in a process of its own; what it says goes to a file beside its folder."""

    def __init__(self, run: Planned) -> None:
        self.run, self.name = run, f"{run.variant.name}, seed {run.seed}"
        self._folder = RunFolder(run.folder)
        run.folder.parent.mkdir(parents=True, exist_ok=True)
        self._log = run.folder.with_suffix(".log")
        self._steps = len(self._folder.points())
        command = [sys.executable, "-m", "giirl", "train"]
        if (self._folder.checkpoints / LATEST).exists():
            command += ["--resume", str(run.folder)]
        else:
            shutil.rmtree(run.folder, ignore_errors=True)  # of a run that was killed before its first checkpoint
            settings = run.folder.with_suffix(".json")
            self._folder.write(settings, dump_config(replace(run.config, run=str(run.folder))))
            command.append(str(settings))
        with self._log.open("wb") as log:
            # A group of its own: Ctrl-C in the terminal is ours to pass on.
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, process_group=0)

    def progress(self) -> int:
        """Steps since the last look."""
        steps = len(self._folder.points())
        new, self._steps = steps - self._steps, steps
        return new

    def last_words(self) -> str:
        """What it had to say when it failed."""
        lines = self._log.read_text(errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), f"exit status {self.process.returncode}")


def _stop(children: Sequence[_Child]) -> None:
    for child in children:
        child.process.send_signal(signal.SIGINT)
    deadline_s = time.monotonic() + STOP_S
    for child in children:
        try:
            child.process.wait(timeout=max(0.1, deadline_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            child.process.kill()


def evaluate_rewards(runs: Sequence[Planned], display: Display) -> None:
    """Ask each learned reward, once, for other goals than the page's own."""
    from giirl.analysis.goal_sensitivity import sensitivity
    from giirl.analysis.goal_swap import goal_swap
    from giirl.run.train import reward_of_run
    from giirl_core.metrics import Metrics

    for run in runs:
        folder = RunFolder(run.folder)
        if not ALGORITHMS[run.config.algorithm].learns_reward or (folder.path / REWARD_EVAL).exists():
            continue
        reward = reward_of_run(folder.path)
        found: dict[str, Any] = {"sensitivity": sensitivity(run.config, reward, GOAL_SWAP_PAGES, Metrics(), display)}
        if GOAL_SWAP_TASK in run.config.tasks:
            found["goal_swap"] = goal_swap(run.config, reward, GOAL_SWAP_TASK, GOAL_SWAP_PAGES, Metrics(), display)
        write_json(folder.path / REWARD_EVAL, found)


def measure_transfer(runs: Sequence[Planned], display: Display) -> None:
    """How policies do on tasks that they never saw, once."""
    from giirl.run.evaluate import evaluate
    from giirl_core.metrics import Metrics

    for run in runs:
        folder = RunFolder(run.folder)
        if run.variant.transfer_tasks and not (folder.path / TRANSFER).exists():
            policy = folder.weights(latest_checkpoint(folder.checkpoints), "policy")
            config = replace(run.config, tasks=run.variant.transfer_tasks)
            write_json(folder.path / TRANSFER, evaluate(config, policy, Metrics(), display))
