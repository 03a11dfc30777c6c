"""A live line on a terminal, a line every few seconds in a log: long work never looks like a hang."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

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

    def __init__(self, what: str, total: int, done: int, console: Console, bar: Progress | None) -> None:
        self._what, self._total, self._done, self._console, self._bar = what, total, done, console, bar
        self._said_s = time.monotonic()
        self._id = bar.add_task(what, total=total, completed=done, note="") if bar else None

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
    """Progress goes to standard error, tables of results to standard output."""

    def __init__(self) -> None:
        self.console = Console(stderr=True)
        self._results = Console()

    def say(self, text: str) -> None:
        """A line that stays."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def table(self, table: Table) -> None:
        """A result."""
        self._results.print(table)

    @contextmanager
    def busy(self, what: str) -> Iterator[None]:
        """Show that something is going on whose length nobody knows."""
        self.say(what)
        with self.console.status(what) if self.console.is_terminal else nullcontext():
            yield

    @contextmanager
    def job(self, what: str, total: int, done: int = 0) -> Iterator[Job]:
        """Show progress while the block lasts."""
        if not self.console.is_terminal:
            self.say(f"{what} ...")
            yield Job(what, total, done, self.console, None)
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
            yield Job(what, total, done, self.console, bar)
