"""Arguments and options that several commands share."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from rich.table import Table

from giirl_core.config import DEFAULT_TASKS
from giirl_core.files import writable, write_json
from giirl_core.progress import Display


def place(text: str) -> Path:
    """The path that a user wrote; ~ is the home folder. A user who does not exist, as in ~nobody, is part of a name."""
    return Path(os.path.expanduser(text))  # noqa: PTH111 - Path.expanduser raises for such a user


class Place(click.Path):
    """A file or folder. The shell leaves ~ as it is in --out=~/a.json."""

    name = "path"

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return place(str(super().convert(value, param, ctx)))


class OutputFile(Place):
    """A file that a command will write. It must be writable: better to fail now than after an hour of work."""

    name = "file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return writable(super().convert(value, param, ctx))


class OutputFolder(Place):
    """A folder that a command will write files to; it is made if need be."""

    name = "folder"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path: Path = super().convert(value, param, ctx)
        path.mkdir(parents=True, exist_ok=True)
        writable(path / "probe")
        return path


RUN = click.argument("run", type=Place())
JSON = click.option("--json", "json_file", type=OutputFile(), help="Also write the result to this file.")
OUT = click.option("--out", required=True, type=OutputFile(), help="The file to write.")
TASKS = click.option(
    "--task",
    "tasks",
    multiple=True,
    help=f"A task; may be given again.  [default: {', '.join(DEFAULT_TASKS)}]",
)
SEED = click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Other seeds, other pages.")
DEMOS = click.option("--demos", type=Place(), help="Folder of public human recordings.  [default: scripted experts]")


def save_json(file: Path | None, result: object) -> None:
    """Write a result to the file of `--json`, if it was given."""
    if file is not None:
        write_json(file, result)


def save_and_show(file: Path | None, result: object, table: Table) -> None:
    """Write a result to the file of `--json`, then print its table, also when it could not be written."""
    try:
        save_json(file, result)
    finally:
        Display().table(table)


Function = TypeVar("Function", bound=Callable[..., Any])


def seeds(default: int) -> Callable[[Function], Function]:
    """The option `--seeds` of a study."""
    return click.option("--seeds", type=click.IntRange(1), default=default, show_default=True, help="Number of seeds.")
