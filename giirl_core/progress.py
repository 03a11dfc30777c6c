"""Progress of long work: a progress bar on a terminal, a line every few seconds in a log file."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from typing import Any, TextIO

from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table
from rich.text import Text

LOG_INTERVAL_S = 10.0
PROXIED = "rich_proxied_file"
NARROW, WIDEST = 80, 10_000  # columns of a terminal


class _Messages:
    """Standard error, as long as somebody can read it: a closed terminal or pipe must not end the work."""

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()

    @property
    def _stream(self) -> TextIO:
        """Standard error itself: while a progress bar is shown, rich puts an object of its own in its place."""
        stream: TextIO = getattr(sys.stderr, PROXIED, sys.stderr)
        return stream

    def __getattr__(self, name: str) -> Any:
        if name == PROXIED:
            raise AttributeError(name)
        return getattr(self._stream, name)


class Job:
    """Work in progress: `done` of `total` units; with a progress bar if `bar` is given, else with log lines."""

    def __init__(self, title: str, total: int, done: int, console: Console, bar: Progress | None) -> None:
        self._title, self._total, self._done, self._console, self._bar = title, total, done, console, bar
        self._begun, self._begun_s = done, time.monotonic()
        self._logged_s = time.monotonic()
        self._task_id = bar.add_task(title, total=total, completed=done, note="") if bar else None

    def advance(self, count: int = 1, note: str = "") -> None:
        """Report `count` more finished units; `note` is shown next to the progress.

        The time until the first unit is in no estimate, if 0 units are reported meanwhile: it may be a start.
        """
        if self._done == self._begun and not count:
            self._begun_s = time.monotonic()
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


def _unbroken(column: Column) -> list[str]:
    """The parts of a column that must not be cut: the cells of a column of numbers, the words of another."""
    words = " ".join(map(str, [column.header, *column.cells])).split()
    return [*words, *map(str, column.cells if column.justify == "right" or column.no_wrap else ()), ""]


def _as_list(table: Table) -> Iterator[str]:
    """The content of a table, each cell on a line of its own."""
    yield from map(str, filter(None, [table.title]))
    for row in zip(*(column.cells for column in table.columns), strict=True):
        for number, (column, cell) in enumerate(zip(table.columns, row, strict=True)):
            yield f"{'  ' * min(number, 1)}{column.header} {cell}".rstrip()
    yield from map(str, filter(None, [table.caption]))


def _bar_columns(width: int) -> list[ProgressColumn]:
    """What a progress bar shows on a terminal of this width. Only the note is broken into lines; no number is cut."""
    title, count = TextColumn("{task.description}"), MofNCompleteColumn(table_column=Column(no_wrap=True))
    note = TextColumn("{task.fields[note]}", markup=False, table_column=Column(overflow="fold"))
    if width < NARROW:
        return [title, count, note]
    return [SpinnerColumn(), title, BarColumn(bar_width=20), count, TimeElapsedColumn(), TimeRemainingColumn(), note]


def visible(text: str) -> str:
    """A text without control characters, which a terminal would obey: a web page may have written it."""
    return "".join(c if c.isprintable() or c in "\n\t" else "�" for c in text)


class _Plain(Console):
    """A console that prints text as it is: it has no markup, emoji codes or control characters."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        return super().render_str(visible(text), **options)


class Display:
    """The output of a command: messages and progress to standard error, tables of results to standard output."""

    def __init__(self) -> None:
        self.console = _Plain(file=_Messages())

    def say(self, text: str) -> None:
        """Print a line that stays on the terminal."""
        self.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def table(self, table: Table) -> None:
        """Print a table of results. No number or word is cut: too narrow a terminal gets a list, a file long lines."""
        for column in table.columns:
            if column.overflow != "fold":
                column.min_width = max(map(cell_len, _unbroken(column)))
        console = _Plain()
        needed = Measurement.get(console, console.options.update(max_width=WIDEST), table).minimum
        if needed > console.width and console.is_terminal:
            console.print("\n".join(_as_list(table)), highlight=False, markup=False, soft_wrap=True)
        else:
            console.width = max(console.width, needed)
            console.print(table, crop=False)

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
        with Progress(*_bar_columns(self.console.width), console=self.console) as bar:
            yield Job(title, total, done, self.console, bar)
