"""Ctrl-C and SIGTERM: the first signal asks a run to save and stop, the second one interrupts it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event
from types import FrameType


class Stopped(Exception):
    """The run was asked to stop before its end. A checkpoint is saved."""


@contextmanager
def stopping(stop: Event) -> Iterator[None]:
    """In this block Ctrl-C and SIGTERM set `stop`; a second one raises KeyboardInterrupt."""

    def request_stop(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, request_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def raise_if(stop: Event) -> None:
    """Raise Stopped if the event is set."""
    if stop.is_set():
        raise Stopped
