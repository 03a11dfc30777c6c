"""The `giirl reproduce` commands: the figures of the thesis's tabular chapter, with their numbers."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from giirl.cli.demos import writable
from giirl.studies.grid_settings import ABLATION_SEEDS, JOINT_SEEDS, REPORT_SEEDS
from giirl_core.files import atomic_write
from giirl_core.progress import Display

JSON = click.option("--json", "json_file", type=click.Path(path_type=Path), help="Write the numbers here.")
FIGURES = Path("runs/figures")
OUT = click.option(
    "--out", type=click.Path(path_type=Path), default=FIGURES, show_default=True, help="Where the PNG goes."
)


def seeds(default: int) -> Callable[[Any], Any]:
    """How many seeds, from 0 on."""
    return click.option("--seeds", type=click.IntRange(1), default=default, show_default=True, help="How many.")


@click.group()
def reproduce() -> None:
    """Run a study again: a table or a figure of the thesis, or a question beside it."""


@reproduce.command("figure-4.3")
@JSON
@OUT
@seeds(1)
def figure_4_3(json_file: Path | None, out: Path, seeds: int) -> None:
    """The map, and the reward learned for two sentences."""
    from giirl.studies.grid_figures import figure_4_3

    _run(figure_4_3, json_file, out, seeds)


@reproduce.command("figure-4.4")
@JSON
@OUT
@seeds(REPORT_SEEDS)
def figure_4_4(json_file: Path | None, out: Path, seeds: int) -> None:
    """True return against steps for every goal, a band over seeds."""
    from giirl.studies.grid_figures import figure_4_4

    _run(figure_4_4, json_file, out, seeds)


@reproduce.command("gridcraft-joint")
@JSON
@OUT
@seeds(JOINT_SEEDS)
def gridcraft_joint(json_file: Path | None, out: Path, seeds: int) -> None:
    """Many layouts and goals at once, and what carries over to those never seen."""
    from giirl.studies.grid_joint import gridcraft_joint

    _run(gridcraft_joint, json_file, out, seeds)


@reproduce.command("gridcraft-ablations")
@JSON
@seeds(ABLATION_SEEDS)
def gridcraft_ablations(json_file: Path | None, seeds: int) -> None:
    """What each part of the method is worth, and a shaped reward against the sparse one."""
    from giirl.studies.grid_ablations import gridcraft_ablations

    _run(gridcraft_ablations, json_file, FIGURES, seeds)


def _run(study: Callable[[int, Path, Display], dict[str, Any]], json_file: Path | None, out: Path, seeds: int) -> None:
    writable(json_file)
    display, since_s = Display(), time.monotonic()
    result = study(seeds, out, display)
    text = json.dumps(result, indent=2) + "\n"
    if json_file is not None:
        with atomic_write(json_file) as file:
            file.write(text.encode())
    click.echo(text, nl=False)
    display.say(f"{result.get('figure', 'no figure')}, {time.monotonic() - since_s:.0f} s")
