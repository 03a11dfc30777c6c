"""What a number of browsers needs, from the measured costs in benchmarks/results: the table of docs/scaling.md.

After a new measurement: `python -m benchmarks.scale.sizing` prints the tables for docs/scaling.md.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from giirl_core.config import MAX_ACTORS
from giirl_core.processes.open_files import files_for

RESULTS = Path(__file__).parents[1] / "results"
BROWSERS = (1, 10, 100, 1_000, 10_000)
MEMORY_GB = 1.0  # of an actor with its Chrome of 8 tabs
WORKLOADS = {  # name: (key of training.json, seconds that a page takes for a step)
    "MiniWoB, the four tasks": ("four", 0.0),
    "MiniWoB, 52 tasks": ("mix", 0.0),
    "pages that take 1 s for a step": ("mix", 1.0),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """Processor time of one episode, by process. [ms]"""

    actor: float  # with its Chrome
    learner: float
    reward_service: float
    steps: float  # of an episode


@dataclass(frozen=True, slots=True, kw_only=True)
class Need:
    """What a number of browsers needs."""

    browsers: int
    episodes_per_s: float
    actor_cores: float
    memory_gb: float
    learner_cores: float
    service_cores: float
    learner_files: int


def costs(workload: str) -> Costs:
    """The costs measured by `giirl bench training`."""
    measured: dict[str, Any] = json.loads((RESULTS / "training.json").read_text(encoding="utf-8"))
    row, cores = measured[workload], measured["settings"]["cores"]
    per_episode_ms = 1000 * cores / row["episodes_per_s"]
    share = row["cpu_share"]
    return Costs(
        actor=per_episode_ms * (share["actor"] + share["chrome"]),
        learner=per_episode_ms * share["learner"],
        reward_service=per_episode_ms * share["reward_service"],
        steps=row["steps_per_s"] / row["episodes_per_s"],
    )


def need(workload: str, step_s: float, browsers: int, tabs: int = 8) -> Need:
    """What so many browsers need that play all the time; one has at most one core."""
    cost = costs(workload)
    busiest = 1000 / cost.actor  # episodes per second of one browser on one core
    each = min(busiest, tabs / (cost.steps * step_s)) if step_s else busiest
    rate = browsers * each
    return Need(
        browsers=browsers,
        episodes_per_s=rate,
        actor_cores=rate * cost.actor / 1000,
        memory_gb=browsers * MEMORY_GB,
        learner_cores=rate * cost.learner / 1000,
        service_cores=rate * cost.reward_service / 1000,
        learner_files=files_for(browsers),
    )


def browsers_of_a_learner(workload: str, step_s: float) -> int:
    """How many browsers keep a learner on one core busy."""
    return max(1, math.floor(1 / need(workload, step_s, 1).learner_cores))


def tables() -> Iterator[str]:
    """The lines of the tables, in Markdown."""
    for title, (workload, step_s) in WORKLOADS.items():
        yield f"**{title}**: {browsers_of_a_learner(workload, step_s)} browsers keep one core of the learner busy."
        yield ""
        yield "| browsers | episodes/s | cores of actors | memory, GB | cores of the learner | of reward services |"
        yield "|-|-|-|-|-|-|"
        for browsers in BROWSERS:
            n = need(workload, step_s, browsers)
            yield (
                f"| {browsers:,} | {n.episodes_per_s:,.0f} | {n.actor_cores:,.1f} | {n.memory_gb:,.0f} "
                f"| {n.learner_cores:,.1f} | {n.service_cores:,.1f} |"
            )
        yield ""
    yield "| browsers | files that the learner opens | runs |"
    yield "|-|-|-|"
    for browsers in BROWSERS:
        runs = math.ceil(browsers / MAX_ACTORS)
        yield f"| {browsers:,} | {files_for(min(browsers, MAX_ACTORS)):,} | {runs} |"


if __name__ == "__main__":
    sys.stdout.write("\n".join(tables()) + "\n")
