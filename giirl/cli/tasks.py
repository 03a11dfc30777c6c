"""`giirl tasks`: task files of own pages."""

from __future__ import annotations

from pathlib import Path

import click

from giirl.cli.options import JSON, SEED, OutputFile, save_json
from giirl_core.progress import Display


@click.group()
def tasks() -> None:
    """Tasks on pages of your own."""


@tasks.command()
@click.argument("file", type=click.Path())
@SEED
@click.option("--screenshot", type=OutputFile(), help="Write a PNG of the first page to this file.")
@JSON
def check(file: str, seed: int, screenshot: Path | None, json_file: Path | None) -> None:
    """Open a task file and show drawn instructions, the first page and its elements.

    What is wrong is said in one line.
    """
    from giirl.task_check import check_task, elements_table

    found = check_task(file, seed)
    if screenshot is not None:
        screenshot.write_bytes(found.png)
    save_json(json_file, found.summary())
    for sentence in found.instructions:
        click.echo(sentence)
    Display().table(elements_table(found))
    for line in found.notes():
        Display().say(line)
