"""`giirl status`, `giirl stop` and `giirl clean`: see what runs, end it, and remove what dead runs left."""

from __future__ import annotations

import time
from pathlib import Path

import click
from rich.console import Console
from rich.live import Live
from rich.text import Text

from giirl.cli.options import RUN
from giirl_core.progress import Display

REFRESH_S = 1.0


@click.command()
@click.argument("run", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print a JSON object.")
def status(run: str | None, as_json: bool) -> None:
    """Show the state of RUN: a folder, or HOST:PORT of a learner's metrics.  [default: the newest in runs/]

    In a terminal it is shown until the run ends or you press Ctrl-C.
    """
    from giirl.operate.status import OTHERS_PHASES, lines, newest_run, read_status

    run = run or newest_run()
    state = read_status(run)
    console = Console()
    if as_json:
        click.echo(state.to_json())
    elif not console.is_terminal:
        click.echo("\n".join(lines(state)))
    else:
        with Live(Text("\n".join(lines(state))), console=console, auto_refresh=False) as live:
            while state.phase not in OTHERS_PHASES:
                time.sleep(REFRESH_S)
                state = read_status(run)
                live.update(Text("\n".join(lines(state))), refresh=True)


@click.command()
@RUN
@click.option("--timeout", "timeout_s", type=click.FloatRange(1), default=120.0, show_default=True, help="Seconds.")
def stop(run: Path, timeout_s: float) -> None:
    """Save RUN and end it. It can be on another machine, if that has the same folder."""
    from giirl.operate.stop import stop_run

    display = Display()
    with display.busy(f"stopping {run}"):
        ended = stop_run(run, timeout_s)
    display.say(ended)


@click.command()
@click.argument("runs", nargs=-1, type=click.Path(path_type=Path))
@click.option("--dry-run", is_flag=True, help="Only say what would be removed.")
def clean(runs: tuple[Path, ...], dry_run: bool) -> None:
    """End and remove what dead runs left: processes on the Ray cluster, temporary folders on this machine.

    Without RUNS, everything of this Unix user whose run is dead. A run with a living learner is never touched.
    """
    from giirl.operate.clean import clean_up

    display, found = Display(), clean_up(runs, dry_run=dry_run)
    for line in found:
        display.say(f"{'would remove' if dry_run else 'removed'} {line}")
    if not found:
        display.say("nothing to remove")
