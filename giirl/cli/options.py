"""Arguments and options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from giirl_core.config import DEFAULT_TASKS
from giirl_core.files import write_json


class OutputFile(click.Path):
    """A file that a command will write. Its folder must exist: better to fail now than after an hour of work."""

    name = "file"

    def __init__(self) -> None:
        super().__init__(path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        path = Path(str(super().convert(value, param, ctx)))
        if path.is_dir() or not path.absolute().parent.is_dir():
            raise ValueError(f"cannot write {path}: wanted a file in a folder that exists")
        return path


RUN = click.argument("run", type=click.Path(path_type=Path))
JSON = click.option("--json", "json_file", type=OutputFile(), help="Also write the result to this file.")
OUT = click.option("--out", required=True, type=OutputFile(), help="The file to write.")
TASKS = click.option(
    "--task",
    "tasks",
    multiple=True,
    help=f"A task; may be given again.  [default: {', '.join(DEFAULT_TASKS)}]",
)
SEED = click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Other seeds, other pages.")
DEMOS = click.option(
    "--demos", type=click.Path(path_type=Path), help="Folder of public human recordings.  [default: scripted experts]"
)


def save_json(file: Path | None, result: object) -> None:
    """Write a result to the file of `--json`, if it was given."""
    if file is not None:
        write_json(file, result)


Function = TypeVar("Function", bound=Callable[..., Any])


def seeds(default: int) -> Callable[[Function], Function]:
    """The option `--seeds` of a study."""
    return click.option("--seeds", type=click.IntRange(1), default=default, show_default=True, help="Number of seeds.")
