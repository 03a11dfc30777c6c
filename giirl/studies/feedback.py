"""What answers of a person are worth: success against their number, beside as many plain demonstrations.

The person is simulated. It answers through the same functions as the page of `giirl feedback`, from the page's own
verdict, with mistakes. Nothing else reads the verdict.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from rich.table import Table

from actors.player import AgentSpec, Player, open_browser_player
from giirl.feedback.desk import Desk
from giirl.feedback.selector import Candidate, Selector
from giirl.run.api import train
from giirl.run.folder import RunFolder
from giirl.statistics import Score, percent
from giirl_core.config import Config
from giirl_core.config_file import changed, load_config
from giirl_core.files import write_json
from giirl_core.metrics import Metrics
from giirl_core.progress import Display
from giirl_core.types import Episode, Purpose, Trajectory

TASKS = ("social-media-some", "email-inbox-forward-nl-turk", "email-inbox-nl-turk")
BASE = (  # a policy that is not done yet: few demonstrations, a short training; chosen on seed 100
    f"tasks={list(TASKS)!r}",
    "runtime=serial",
    "demos.per_task=8",
    "policy.bc_warmup_updates=300",
    'policy.prior="clone"',
    "policy.frozen_iterations=15",
    "policy.learning_rate=3e-4",
    "policy.cloning_updates=8",
    "iterations=30",
    "rollout_batch=16",
    "evaluate.episodes=200",
    "evaluate.random_episodes=1",
)
BUDGETS = (100, 200)  # answers, or further demonstrations, given so far
ITERATIONS = 40  # that a run goes on with after each of the BUDGETS
MISTAKES = 0.05  # share of a simulated person's verdicts that are the wrong way round
MEASURED = "feedback_study.json"  # in a run's folder
WINDOW = "simulated"
SEED_BITS = (1 << 32) - 1  # of a page seed: its index

Show = Callable[[Candidate], Trajectory | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """What a run gets before it goes on."""

    name: str
    give: Callable[[RunFolder, Config, int, int], None]  # so many answers or demonstrations, after so many before


class SimulatedPerson:
    """Calls an episode right if the page did, and is mistaken in `mistakes` of all cases.

    Of a wrong one it marks the last step. With `show` it also shows the right way, if it knows one.
    """

    def __init__(self, mistakes: float, rng: np.random.Generator, show: Show | None = None) -> None:
        self._mistakes, self._rng, self._show = mistakes, rng, show

    def answer(self, desk: Desk, candidate: Candidate) -> None:
        """Answer about an episode that the desk has lent."""
        outcome, last = candidate.view.outcome, len(candidate.trajectory) - 1
        assert outcome is not None
        mistaken = bool(self._rng.random() < self._mistakes)
        if outcome.success is not mistaken:
            desk.answer(candidate.key)
        else:
            desk.answer(candidate.key, wrong_from=last, shown=self._show(candidate) if self._show else None)


def give_answers(
    folder: RunFolder, config: Config, count: int, person: SimulatedPerson, seed: int | None = None
) -> None:
    """Let a person answer about `count` episodes of the latest policy."""
    desk, given = Desk(folder.feedback), 0
    with Selector(folder, config, screenshots=False, seed=seed) as selector:
        while given < count:
            desk.offer(selector.choose(Event()))
            while given < count and (candidate := desk.take(WINDOW)) is not None:
                person.answer(desk, candidate)
                given += 1


def _give_nothing(folder: RunFolder, config: Config, count: int, before: int) -> None:
    """The run only goes on."""


def _give_verdicts(folder: RunFolder, config: Config, count: int, before: int) -> None:
    person = SimulatedPerson(MISTAKES, np.random.default_rng([config.seed, before]))
    give_answers(folder, config, count, person, seed=before)


def _give_corrections(folder: RunFolder, config: Config, count: int, before: int) -> None:
    with _showing(config) as show:
        person = SimulatedPerson(MISTAKES, np.random.default_rng([config.seed, before]), show)
        give_answers(folder, config, count, person, seed=before)


def _give_demonstrations(folder: RunFolder, config: Config, count: int, before: int) -> None:
    """Further demonstrations of random pages, equally many of each task."""
    each, first = -(-count // len(config.tasks)), config.demos.per_task + -(-before // len(config.tasks))
    with open_browser_player(config, Metrics()) as player:
        played = player.play(AgentSpec(kind="expert"), Purpose.DEMONSTRATE, each, first=first)
    further = sorted((e for e in played if _is_good(e)), key=lambda e: (e.trajectory.task, e.trajectory.seed))
    folder.save_demonstrations([*folder.load_demonstrations(), *further])


ARMS = (
    Arm(name="no answers", give=_give_nothing),
    Arm(name="right or wrong", give=_give_verdicts),
    Arm(name="right or wrong, and the right way", give=_give_corrections),
    Arm(name="demonstrations of random pages", give=_give_demonstrations),
)


@contextmanager
def _showing(config: Config) -> Iterator[Show]:
    """The right way through the page of an episode, as the scripted expert shows it."""
    with open_browser_player(config, Metrics()) as player:
        yield lambda candidate: _expert_way(player, candidate)


def _expert_way(player: Player, candidate: Candidate) -> Trajectory | None:
    view = candidate.view
    expert, index = AgentSpec(kind="expert"), view.seed & SEED_BITS
    played = player.play(expert, Purpose.FEEDBACK, 1, tasks=[view.task], first=index)
    return played[0].trajectory if played and _is_good(played[0]) else None


def _is_good(episode: Episode) -> bool:
    return episode.outcome.success and not episode.trajectory.unlearnable()


def feedback_study(seeds: Sequence[int], root: Path, changes: Sequence[str], display: Display) -> dict[str, Any]:
    """Train a run for each seed, then go on with a copy of it in each arm. What is measured already is not repeated."""
    rows: list[dict[str, Any]] = []
    settings = [*BASE, *changes]
    place = root / f"feedback-{hashlib.sha256(repr((settings, BUDGETS, ITERATIONS)).encode()).hexdigest()[:8]}"
    for seed in seeds:
        config = load_config(None, [*settings, f"seed={seed}"])
        base = place / f"seed-{seed}"
        if not RunFolder(base).result.is_file():
            shutil.rmtree(base, ignore_errors=True)
            train(config, RunFolder.create(replace(config, run=str(base)), "feedback"), None, display)
        start = _row(0, json.loads(RunFolder(base).result.read_bytes()))
        for number, arm in enumerate(ARMS):
            display.say(f"seed {seed}: {arm.name}")
            copy = place / f"seed-{seed}-{number}"
            rows.append(
                {"arm": arm.name, "seed": seed, "measured": [start, *_measured(arm, config, base, copy, display)]}
            )
    return {
        "study": "feedback",
        "settings": [one for one in changed(load_config(None, settings)) if not one.startswith("seed=")],
        "mistakes": MISTAKES,
        "arms": {arm.name: _pooled([row["measured"] for row in rows if row["arm"] == arm.name]) for arm in ARMS},
        "runs": rows,
    }


def _measured(arm: Arm, config: Config, base: Path, path: Path, display: Display) -> list[dict[str, Any]]:
    """Success of an arm after each of the BUDGETS, in a copy of the run `base`."""
    if (path / MEASURED).is_file():
        found: list[dict[str, Any]] = json.loads((path / MEASURED).read_bytes())
        return found
    shutil.rmtree(path, ignore_errors=True)
    shutil.copytree(base, path)
    folder, rows, given, length = RunFolder(path), [], 0, config.iterations
    for budget in BUDGETS:
        arm.give(folder, config, budget - given, given)
        given, length = budget, length + ITERATIONS
        longer = replace(config, run=str(path), iterations=length)
        rows.append(_row(given, train(longer, folder, folder.latest_checkpoint(), display)))
    write_json(path / MEASURED, rows)
    return rows


def _row(given: int, result: dict[str, Any]) -> dict[str, Any]:
    return {"given": given, "tasks": result["tasks"]}


def _pooled(runs: Sequence[Sequence[dict[str, Any]]]) -> list[dict[str, Any]]:
    """Success at each budget over all tasks and seeds, and of each task over all seeds."""
    found = []
    for rows in zip(*runs, strict=True):
        tasks = {task: _total([row["tasks"][task] for row in rows]) for task in rows[0]["tasks"]}
        every = sum(tasks.values(), Score(episodes=0, successes=0))
        found.append({"given": rows[0]["given"], **every.row(), "tasks": {t: one.row() for t, one in tasks.items()}})
    return found


def _total(rows: Sequence[dict[str, Any]]) -> Score:
    episodes = [row["episodes"] for row in rows]
    won = [round(row["episodes"] * (row["success"] or 0.0)) for row in rows]
    return Score(episodes=sum(episodes), successes=sum(won))


def feedback_table(result: dict[str, Any]) -> Table:
    """Success of each arm against what was given, with its interval."""
    arms = result["arms"]
    budgets = [row["given"] for row in next(iter(arms.values()))]
    table = Table(title="Success against answers or demonstrations given, %")
    table.add_column("")
    for budget in budgets:
        table.add_column(str(budget), justify="right")
    for name, rows in arms.items():
        table.add_row(name, *(f"{percent(r['success'])} ({100 * r['low']:.1f} - {100 * r['high']:.1f})" for r in rows))
        for task in rows[0]["tasks"]:
            table.add_row(f"  {task}", *(percent(row["tasks"][task]["success"]) for row in rows))
    return table
