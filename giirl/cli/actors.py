"""`giirl actors`: change the number of actors of a running run."""

from __future__ import annotations

from pathlib import Path

import click

from giirl.cli.options import RUN
from giirl.run.folder import RunFolder
from giirl_core.config import MAX_ACTORS
from giirl_core.files import is_locked
from giirl_core.progress import Display


@click.command()
@RUN
@click.argument("count", type=click.IntRange(1, MAX_ACTORS))
def actors(run: Path, count: int) -> None:
    """Change the number of actors of RUN to COUNT while it runs.

    The run notices within a second. Surplus actors send their finished episodes before they end.
    """
    folder, config = RunFolder.open(run)
    if config.runtime == "serial" or config.stream.policy_lag == 0:
        raise ValueError(f"{run} uses the serial runtime or lock-step: its number of actors is fixed")
    if not is_locked(run):
        over = "has ended" if folder.result.is_file() else "is not running"
        raise ValueError(f"{run} {over}: it has no actors to change; to go on: giirl train --resume {run}")
    folder.write(folder.wanted, str(count))
    Display().say(f"{run}: {count} actors from now on")
