"""`giirl report`: a run on one page."""

from __future__ import annotations

from pathlib import Path

import click

from giirl.cli.demos import writable
from giirl.run.folder import RunFolder
from giirl_core.progress import Display

RUN = click.argument("run", type=click.Path(path_type=Path))


@click.command()
@RUN
@click.option("--out", type=click.Path(path_type=Path), help="Where the page goes.  [default: RUN/report.html]")
@click.option("--pages", default=3, show_default=True, type=click.IntRange(1, 100), help="Episodes to show a task.")
def report(run: Path, out: Path | None, pages: int) -> None:
    """Write one self-contained HTML page about a run: its numbers, its curves, and episodes as film strips."""
    from actors.browser import check_tasks
    from giirl.report.build import report

    folder, config = RunFolder.open(run)
    if config.world == "miniwob":
        check_tasks(config)
    out = out or folder.path / "report.html"
    writable(out)
    report(folder, config, out, pages, f"giirl report {run} --pages {pages}", Display())
    drawn(out)


def drawn(page: Path) -> None:
    """Say where a page lies and how large it is."""
    Display().say(f"{page}, {page.stat().st_size / 1e6:.1f} MB: open it in any browser")
