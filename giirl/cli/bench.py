"""The `giirl bench` commands: what is fast and what it costs, measured beside what it replaces."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from giirl.cli.demos import writable
from giirl_core.files import atomic_write
from giirl_core.progress import Display

JSON = click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write the numbers here.")


@click.group()
def bench() -> None:
    """Measure how fast things are, beside what they replace, on this machine."""


@bench.command()
@click.option("--task", "tasks", multiple=True, help="Only this task; may be given again.")
@click.option("--rounds", default=5, show_default=True, type=click.IntRange(1), help="Turns of each side, a task.")
@click.option("--seconds", default=2.0, show_default=True, type=click.FloatRange(0.1), help="Length of a turn.")
@JSON
def farm(tasks: tuple[str, ...], rounds: int, seconds: float, json_file: Path | None) -> None:
    """The browser farm beside the miniwob package's environment: steps per second, CPU, memory."""
    from benchmarks.farm import TASKS, measure

    for task in tasks:
        if task not in TASKS:
            raise ValueError(f"the benchmark plays {', '.join(TASKS)}, not {task!r}")
    if json_file is not None:
        writable(json_file)
    display = Display()
    found = measure(display, tasks=tasks or TASKS, rounds=rounds, seconds=seconds)
    table = Table("task", "steps/s", "CPU ms/step", "steps/core-s", "x miniwob", "x without screenshots")
    for task, row in found["tasks"].items():
        table.add_row(
            task,
            f"{row['steps_per_s']:.0f}",
            f"{row['cpu_ms_per_step']:.2f}",
            f"{row['steps_per_core_second']:.0f}",
            f"{row['ratio_miniwob']:.0f}",
            f"{row['ratio_miniwob_no_screenshot']:.0f}",
        )
    display.table(table)
    for name, value in found["memory"].items():
        click.echo(f"{name}: {value}")
    save(json_file, found)


@bench.command()
@JSON
def wire(json_file: Path | None) -> None:
    """Encode and decode an episode of 100 KB, against memcpy."""
    measure("wire", json_file)


@bench.command()
@JSON
def scoring(json_file: Path | None) -> None:
    """Round trips of a scoring request, transport alone, against Ray's actor calls."""
    measure("scoring", json_file)


@bench.command()
@JSON
def ingest(json_file: Path | None) -> None:
    """Episodes of 100 KB into the learner's queue, against Ray's actor calls and its object store."""
    measure("ingest", json_file)


@bench.command()
@JSON
def scale(json_file: Path | None) -> None:
    """The learner's cost per trajectory at 1,000 simulated actors, against 10."""
    measure("scale", json_file)


def measure(name: str, json_file: Path | None) -> None:
    """Run one benchmark; show and save what it found under its name."""
    from benchmarks.transport import BENCHES

    writable(json_file)
    display = Display()
    with display.busy(f"measuring {name}"):
        found: dict[str, Any] = BENCHES[name]()
    for key, value in found.items():
        display.say(f"{name}.{key} = {value}")
    save(json_file, {name: found, "load_average": round(os.getloadavg()[0], 1)})


def save(json_file: Path | None, found: dict[str, Any]) -> None:
    """Write a command's numbers where it was asked to."""
    if json_file is not None:
        with atomic_write(json_file) as file:
            file.write(json.dumps(found, indent=2).encode() + b"\n")
