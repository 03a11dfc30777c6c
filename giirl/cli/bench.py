"""The `giirl bench` commands: speed and cost, compared with the alternatives."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from giirl.cli.options import JSON, save_and_show, save_json
from giirl_core.progress import Display

TRANSPORT = {  # command: help. The functions are `benchmarks.transport.BENCHES`, under the same names.
    "wire": "Encode and decode an episode of 100 KB, compared with memcpy.",
    "scoring": "Round trips of a scoring request, transport only, compared with Ray's actor calls.",
    "ingest": "Episodes of 100 KB into the learner's queue, compared with Ray's actor calls and its object store.",
    "scale": "The learner's cost per trajectory at 1,000 simulated actors, compared with 10.",
}


@click.group()
def bench() -> None:
    """Measure speed on this machine, compared with the alternatives."""


@bench.command()
@click.option("--task", "tasks", multiple=True, help="Only this task; may be given again.")
@click.option("--rounds", default=5, show_default=True, type=click.IntRange(1), help="Turns of each side per task.")
@click.option("--seconds", default=2.0, show_default=True, type=click.FloatRange(0.1), help="Length of a turn.")
@JSON
def farm(tasks: tuple[str, ...], rounds: int, seconds: float, json_file: Path | None) -> None:
    """The browser farm compared with the miniwob package's environment: steps per second, CPU, memory."""
    from benchmarks.farm import TASKS, measure

    for task in tasks:
        if task not in TASKS:
            raise ValueError(f"the benchmark has no task {task!r}: wanted {', '.join(TASKS)}")
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
    save_and_show(json_file, found, table)
    for name, value in found["memory"].items():
        click.echo(f"{name}: {value}")


@bench.command()
@click.option("--before", default="", metavar="COMMIT", help="Compare with this commit, in turns.")
@click.option("--turns", default=3, show_default=True, type=click.IntRange(1), help="Turns of each side.")
@JSON
def learner(before: str, turns: int, json_file: Path | None) -> None:
    """The learner's CPU time on a fixture of pages: four tasks, fifty-two tasks, cloning."""
    from benchmarks.learner import measure

    _report(measure(Display(), before=before, turns=turns), json_file)


@bench.command()
@click.option("--actors", default=1, show_default=True, type=click.IntRange(1), help="Actors of the run.")
@click.option("--tabs", default=8, show_default=True, type=click.IntRange(1), help="Tabs of each actor.")
@click.option("--case", "cases", multiple=True, type=click.Choice(["four", "mix"]), help="Only this one.")
@JSON
def training(actors: int, tabs: int, cases: tuple[str, ...], json_file: Path | None) -> None:
    """A whole run in Chrome compared with the bare farm: steps per second, CPU shares, waiting."""
    from benchmarks.training import measure

    _report(measure(Display(), actors=actors, tabs=tabs, cases=cases or ("four", "mix")), json_file)


@bench.command()
@click.option("--actors", multiple=True, type=click.IntRange(1), help="A number of actors; may be given again.")
@click.option("--delay", default=0.2, show_default=True, type=click.FloatRange(0), help="Seconds of every page step.")
@click.option("--seeds", default=3, show_default=True, type=click.IntRange(1), help="Runs of each number of actors.")
@JSON
def scaling(actors: tuple[int, ...], delay: float, seeds: int, json_file: Path | None) -> None:
    """Time to 95 % on two tasks with 1, 2, 4 and 8 actors, on pages that respond slowly."""
    from benchmarks.scale.actors import measure

    _report(measure(Display(), actors=actors or (1, 2, 4, 8), delay_s=delay, seeds=seeds), json_file)


def _report(found: dict[str, Any], json_file: Path | None) -> None:
    """Write the JSON, and print every number."""
    save_json(json_file, found)
    for group, values in found.items():
        for name, value in values.items() if isinstance(values, dict) else [("", values)]:
            click.echo(f"{group}.{name} = {value}" if name else f"{group} = {value}")


def _transport_command(name: str) -> click.Command:
    @click.command(name, help=TRANSPORT[name])
    @JSON
    def command(json_file: Path | None) -> None:
        from benchmarks.transport import BENCHES

        display = Display()
        with display.busy(f"measuring {name}"):
            found: dict[str, Any] = BENCHES[name]()
        save_json(json_file, {name: found, "load_average": round(os.getloadavg()[0], 1)})
        for key, value in found.items():
            display.say(f"{name}.{key} = {value}")

    return command


for each in TRANSPORT:
    bench.add_command(_transport_command(each))
