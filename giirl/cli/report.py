"""`giirl report`: a run on one HTML page."""

from __future__ import annotations

from pathlib import Path

import click

from giirl.cli.options import RUN, OutputFile
from giirl.run.folder import RunFolder
from giirl.run.worlds import world_of
from giirl_core.files import writable
from giirl_core.progress import Display


@click.command()
@RUN
@click.option("--out", type=OutputFile(), help="The HTML file to write.  [default: RUN/report.html]")
@click.option("--pages", default=3, show_default=True, type=click.IntRange(1, 100), help="Episodes shown per task.")
def report(run: Path, out: Path | None, pages: int) -> None:
    """Write one self-contained HTML page about a run: its numbers, its curves, and episodes as film strips."""
    from giirl.report.build import report

    folder, config = RunFolder.open(run)
    world_of(config).check(config)
    out = out or writable(folder.path / "report.html")
    report(folder, config, out, pages, f"giirl report {run} --pages {pages}", Display())
    say_written(out)


def say_written(page: Path) -> None:
    """Print the path and the size of an HTML file."""
    Display().say(f"{page}, {page.stat().st_size / 1e6:.1f} MB: open it in any browser")
