"""giirl actors: more or fewer of them while a run goes on."""

from __future__ import annotations

from pathlib import Path

import click

from giirl.run.folder import RunFolder
from giirl_core.config import MAX_ACTORS
from giirl_core.progress import Display


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("count", type=click.IntRange(1, MAX_ACTORS))
def actors(run: Path, count: int) -> None:
    """Have COUNT actors play for RUN from now on.

    Those that are too many hand over what they have finished and leave; the run takes notice within a second.
    """
    folder, config = RunFolder.open(run)
    if config.runtime == "serial" or config.stream.policy_lag == 0:
        raise ValueError(f"{run} plays in one thread or in lock-step: its number of actors is fixed")
    folder.write(folder.wanted, str(count))
    Display().say(f"{run}: {count} actors from now on")
