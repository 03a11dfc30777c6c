"""How a run is asked to end before it is done: politely once, and then not."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event
from types import FrameType


class Stopped(Exception):
    """The run was asked to end before it was done; what it had is saved."""


@contextmanager
def stopping(stop: Event) -> Iterator[None]:
    """While this lasts Ctrl-C and SIGTERM ask politely; the second time they interrupt."""

    def ask(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def raise_if(stop: Event) -> None:
    """Stopped, where somebody asked for it."""
    if stop.is_set():
        raise Stopped
