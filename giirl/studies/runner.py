"""Runs the variants and seeds of a study, each as a `giirl train` process. Finished runs are reused, others resumed."""

from __future__ import annotations

import hashlib
import json
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
from giirl_core.telemetry.version import VERSION, commit

POLL_S = 1.0
REWARD_EVAL = "reward_eval.json"  # in a run's folder: measures of its reward
TRANSFER = "transfer.json"  # in a run's folder: success on tasks that it did not train on
GOAL_SWAP_TASK, GOAL_SWAP_PAGES = "click-button", 500
STOP_TIMEOUT_S = 60.0  # for a stopped run to save and end


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """Settings of a study's runs, as key=value, in addition to those that all its variants share.

    With `reward_of`, a run trains on the frozen reward of that variant's run with the same seed. `transfer_tasks` are
    further tasks to evaluate the policy on.
    """

    name: str
    changes: tuple[str, ...] = ()
    reward_of: str = ""
    transfer_tasks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """One run of a study. The name of its folder is a hash of its settings and the version of GIIRL."""

    variant: Variant
    seed: int
    config: Config
    folder: Path

    @property
    def name(self) -> str:
        return f"{self.variant.name}, seed {self.seed}"

    @property
    def done(self) -> bool:
        return RunFolder(self.folder).result.is_file()

    @property
    def made_by(self) -> str:
        """The commit of the code that a finished run was made with."""
        return str(json.loads(RunFolder(self.folder).result.read_bytes()).get("commit", ""))


def plan(base: Sequence[str], variants: Sequence[Variant], seeds: Sequence[int], root: Path) -> list[Planned]:
    """All runs of a study; a run that needs the reward of another one comes after it.

    ValueError for an unknown setting.
    """
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
    """Do the runs that are not done, `jobs` at a time.

    If some fail, the others are finished first, then RuntimeError is raised. Ctrl-C stops all runs with a checkpoint;
    the same command resumes them.
    """
    waiting = list({run.folder: run for run in runs if not run.done}.values())
    for run in {run.folder: run for run in runs if run.done and run.made_by != commit()}.values():
        made = run.made_by or "an unknown commit"
        display.say(f"{run.name} is used again, made by other code ({made}); delete {run.folder} to run it with this")
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
                    job.advance(child.progress(), child.note())
                    if child.process.poll() is None:
                        continue
                    children.remove(child)
                    if not child.run.done:
                        failed.append(f"{child.name}: {child.last_line()}")
                        waiting = [run for run in waiting if run.config.reward_from != str(child.run.folder)]
        finally:
            _stop(children)
    if failed:
        raise RuntimeError(f"{len(failed)} runs failed, the first of them {failed[0]}; the same command tries again")


def _ready(waiting: Sequence[Planned]) -> list[Planned]:
    """The runs that need no other run's reward, or whose reward is already learned."""
    return [run for run in waiting if not (of := run.config.reward_from) or RunFolder(Path(of)).result.is_file()]


class _Child:
    """A run in a process of its own; its output goes to a file next to its folder."""

    def __init__(self, run: Planned) -> None:
        self.run, self.name = run, run.name
        self._folder = RunFolder(run.folder)
        run.folder.parent.mkdir(parents=True, exist_ok=True)
        self._log = run.folder.with_suffix(".log")
        self._steps = len(self._folder.points())
        command = [sys.executable, "-m", "giirl", "train"]
        if self._folder.saved:
            command += ["--resume", str(run.folder)]
        else:
            settings = run.folder.with_suffix(".json")
            self._folder.write(settings, dump_config(replace(run.config, run=str(run.folder))))
            command.append(str(settings))
        with self._log.open("wb") as log:
            # Its own process group: Ctrl-C in the terminal reaches only this process, which stops the children itself.
            self.process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, process_group=0)

    def progress(self) -> int:
        """The number of iterations since the last call."""
        steps = len(self._folder.points())
        new, self._steps = steps - self._steps, steps
        return new

    def note(self) -> str:
        """What it is doing: before its first iteration, what it printed last."""
        return self.name if self._steps else f"{self.name}: {self.last_line()}"

    def last_line(self) -> str:
        """The last line of its output, or its exit status."""
        lines = self._log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line for line in reversed(lines) if line.strip()), f"exit status {self.process.returncode}")


def _stop(children: Sequence[_Child]) -> None:
    for child in children:
        child.process.send_signal(signal.SIGINT)
    deadline_s = time.monotonic() + STOP_TIMEOUT_S
    for child in children:
        try:
            child.process.wait(timeout=max(0.1, deadline_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            child.process.kill()


def evaluate_rewards(runs: Sequence[Planned], display: Display) -> None:
    """Measure, once for each learned reward, whether it depends on the goal."""
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
    """Evaluate policies, once, on the tasks of their variant that they did not train on."""
    from giirl.run.evaluate import evaluate
    from giirl_core.metrics import Metrics

    for run in runs:
        folder = RunFolder(run.folder)
        if run.variant.transfer_tasks and not (folder.path / TRANSFER).exists():
            policy = folder.weights(folder.latest_checkpoint(), "policy")
            config = replace(run.config, tasks=run.variant.transfer_tasks)
            write_json(folder.path / TRANSFER, evaluate(config, policy, Metrics(), display))
