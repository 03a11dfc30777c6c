"""The `giirl reproduce` commands of the tabular chapter: each study is one command with one JSON."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import click

from giirl.cli.options import JSON, OutputFolder, save_json, seeds
from giirl.studies.grid_settings import ABLATION_SEEDS, JOINT_SEEDS, REPORT_SEEDS
from giirl_core.progress import Display

FIGURES = Path("runs/figures")
OUT = click.option("--out", type=OutputFolder(), default=FIGURES, show_default=True, help="Folder for the PNG.")


@dataclass(frozen=True, slots=True, kw_only=True)
class GridCommand:
    """A study of the grid as a command; its function is in `giirl.studies.grid.STUDIES`, under the same name."""

    help: str
    seeds: int  # by default
    draws_figure: bool = True


GRID_COMMANDS = {
    "figure-4.3": GridCommand(help="The map, and the reward learned for two sentences.", seeds=1),
    "figure-4.4": GridCommand(
        help="True return against environment steps for every goal, a band over seeds.", seeds=REPORT_SEEDS
    ),
    "gridcraft-joint": GridCommand(
        help="Many layouts and goals at once, and the transfer to unseen layouts and goals.", seeds=JOINT_SEEDS
    ),
    "gridcraft-maxent": GridCommand(
        help="The joint study's setting with maximum-entropy inverse reinforcement learning, which knows the dynamics.",
        seeds=JOINT_SEEDS,
        draws_figure=False,
    ),
    "gridcraft-ablations": GridCommand(
        help="Each part of the method left out, and a shaped reward compared with the sparse one.",
        seeds=ABLATION_SEEDS,
        draws_figure=False,
    ),
}


@click.group()
def reproduce() -> None:
    """Run a study again: a table or figure of the thesis, or a further study."""


def _grid_command(name: str) -> click.Command:
    study = GRID_COMMANDS[name]

    @click.command(name, help=study.help)
    @JSON
    @seeds(study.seeds)
    def command(json_file: Path | None, seeds: int, out: Path = FIGURES) -> None:
        from giirl.studies.grid import STUDIES

        display, since_s = Display(), time.monotonic()
        result = STUDIES[name](seeds, out, display)
        save_json(json_file, result)
        click.echo(json.dumps(result, indent=2))
        display.say(f"{result.get('figure', 'no figure')}, {time.monotonic() - since_s:.0f} s")

    return OUT(command) if study.draws_figure else command


for each in GRID_COMMANDS:
    reproduce.add_command(_grid_command(each))
