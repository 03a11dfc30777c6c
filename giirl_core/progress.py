"""Progress of long work: a progress bar on a terminal, a line every few seconds in a log file."""

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

LOG_INTERVAL_S = 10.0


class Job:
    """Work in progress: `done` of `total` units; with a progress bar if `bar` is given, else with log lines."""

    def __init__(self, title: str, total: int, done: int, console: Console, bar: Progress | None) -> None:
        self._title, self._total, self._done, self._console, self._bar = title, total, done, console, bar
        self._begun, self._begun_s = done, time.monotonic()
        self._logged_s = time.monotonic()
        self._task_id = bar.add_task(title, total=total, completed=done, note="") if bar else None

    def advance(self, count: int = 1, note: str = "") -> None:
        """Report `count` more finished units; `note` is shown next to the progress."""
        self._done += count
        if self._bar is not None and self._task_id is not None:
            self._bar.update(self._task_id, completed=self._done, note=note)
        elif time.monotonic() - self._logged_s >= LOG_INTERVAL_S or self._done >= self._total > self._done - count:
            self._logged_s = time.monotonic()
            now = time.strftime("%Y-%m-%d %H:%M:%S")
            self._console.print(
                f"{now} {self._title} {self._done}/{self._total}{self._left()}  {note}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )

    def _left(self) -> str:
        """How long the rest takes at the rate so far, as ", 1:02:03 left"; "" at the end."""
        done, seconds = self._done - self._begun, time.monotonic() - self._begun_s
        rest = self._total - self._done
        return f", {duration(seconds / done * rest)} left" if done > 0 < rest else ""


def duration(seconds: float) -> str:
    """A time like "1:02:03" or "2:03": hours, minutes, seconds."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


class Display:
    """The output of a command: messages and progress to standard error, tables of results to standard output."""

    def __init__(self) -> None:
        self.console = Console(stderr=True)
        self.results = Console()

    def say(self, text: str) -> None:
        """Print a line that stays on the terminal."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def table(self, table: Table) -> None:
        """Print a table of results."""
        self.results.print(table)

    @contextmanager
    def busy(self, title: str) -> Iterator[None]:
        """Show a spinner while the block runs, for work of unknown length."""
        self.say(title)
        with self.console.status(title) if self.console.is_terminal else nullcontext():
            yield

    @contextmanager
    def job(self, title: str, total: int, done: int = 0) -> Iterator[Job]:
        """Show the progress of `total` units while the block runs; `done` of them are finished already."""
        if not self.console.is_terminal:
            self.say(f"{title} ...")
            yield Job(title, total, done, self.console, None)
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
            yield Job(title, total, done, self.console, bar)
