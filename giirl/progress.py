"""A live line on a terminal, a line every few seconds in a log: long work never looks like a hang."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

LOG_EVERY_S = 10.0


class Job:
    """One piece of long work under way."""

    def __init__(self, what: str, total: int, console: Console, bar: Progress | None) -> None:
        self._what, self._total, self._console, self._bar = what, total, console, bar
        self._done = 0
        self._said_s = time.monotonic()
        self._id = bar.add_task(what, total=total, note="") if bar else None

    def advance(self, count: int = 1, note: str = "") -> None:
        """Say that `count` more are done; `note` stands beside it."""
        self._done += count
        if self._bar is not None and self._id is not None:
            self._bar.update(self._id, completed=self._done, note=note)
        elif time.monotonic() - self._said_s >= LOG_EVERY_S or self._done >= self._total > self._done - count:
            self._said_s = time.monotonic()
            self._console.print(
                f"{self._what} {self._done}/{self._total}  {note}", highlight=False, markup=False, soft_wrap=True
            )


class Display:
    """Where progress and results are shown; standard error, so that results can be piped."""

    def __init__(self, console: Console | None = None) -> None:
        self.console = console or Console(stderr=True)

    def say(self, text: str) -> None:
        """A line that stays."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def table(self, table: Table) -> None:
        self.console.print(table)

    @contextmanager
    def job(self, what: str, total: int, done: int = 0) -> Iterator[Job]:
        """Show progress while the block lasts."""
        if not self.console.is_terminal:
            self.say(f"{what} ...")
            job = Job(what, total, self.console, None)
            job._done = done
            yield job
            return
        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        with Progress(*columns, console=self.console) as bar:
            job = Job(what, total, self.console, bar)
            job.advance(done)
            yield job
