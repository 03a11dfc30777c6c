"""giirl bench: what the system's parts cost, measured beside what they replace."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import click

from giirl.cli_demos import writable
from giirl.files import whole_file
from giirl.progress import Display

JSON = click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write the result here.")


@click.group()
def bench() -> None:
    """What moving pages, episodes and rewards costs."""


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
    from giirl.run_bench import BENCHES

    writable(json_file)
    display = Display()
    with display.busy(f"measuring {name}"):
        found: dict[str, Any] = BENCHES[name]()
    for key, value in found.items():
        display.say(f"{name}.{key} = {value}")
    if json_file is not None:
        with whole_file(json_file) as file:
            file.write(
                (json.dumps({name: found, "load_average": round(os.getloadavg()[0], 1)}, indent=2) + "\n").encode()
            )
