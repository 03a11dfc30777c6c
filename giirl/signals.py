"""Ctrl-C, SIGTERM and SIGHUP: the first asks a run to save and stop, the second interrupts it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event
from types import FrameType
from typing import Any


class Stopped(Exception):
    """The run was asked to stop before its end. A checkpoint is saved."""


@contextmanager
def stopping(stop: Event) -> Iterator[None]:
    """In this block Ctrl-C, SIGTERM and SIGHUP set `stop`; a second one raises KeyboardInterrupt.

    A closing terminal sends SIGHUP, often twice, so a second SIGHUP does nothing.
    """

    def request_stop(number: int, frame: FrameType | None) -> None:
        if stop.is_set() and number != signal.SIGHUP:
            raise KeyboardInterrupt
        stop.set()

    with handling(request_stop):
        yield


@contextmanager
def handling(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Call `handler` for Ctrl-C, SIGTERM and SIGHUP in this block."""
    before = on_signals(handler)
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)


def on_signals(handler: Callable[[int, FrameType | None], None]) -> dict[int, Any]:
    """Call `handler` for Ctrl-C, SIGTERM and SIGHUP; returns the handlers before. Under nohup SIGHUP stays ignored."""
    hangup = () if signal.getsignal(signal.SIGHUP) is signal.SIG_IGN else (signal.SIGHUP,)
    return {number: signal.signal(number, handler) for number in (signal.SIGINT, signal.SIGTERM, *hangup)}


def raise_if(stop: Event) -> None:
    """Raise Stopped if the event is set."""
    if stop.is_set():
        raise Stopped
