"""Runs one routine per tab, all at the same time: a routine is a generator that yields what it waits for."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from typing import TypeVar

from browser_farm.chrome.answers import Failure
from browser_farm.chrome.devtools import DevTools

T = TypeVar("T")
POLL_S = 0.005  # how often what is no message from Chrome is looked at, such as a program that runs


@dataclass(frozen=True, slots=True)
class Wait:
    """Until something is ready, or until a deadline (`time.monotonic`). The routine is sent whether it is ready."""

    ready: Callable[[], bool]
    deadline: float
    polls: bool = False  # what is waited for does not come as a message from Chrome


Routine = Generator[Wait, bool, T]


class TabFailed(Exception):
    """A tab cannot go on with its episode: the infrastructure, or the application, does not work."""

    def __init__(self, cause: str, message: str = "") -> None:
        super().__init__(message)
        self.failure = Failure(cause=cause, message=message)


class ScriptThrew(TabFailed):
    """A script of a task file threw an exception in the page."""


def sleep(seconds: float) -> Routine[None]:
    """Wait while other routines and messages go on."""
    yield Wait(lambda: False, time.monotonic() + seconds)


def run_all(tools: DevTools, routines: Mapping[int, Routine[T]]) -> dict[int, T | Failure]:
    """Run all routines to their end; what each returns, or the Failure with which it ended.

    Raises BrowserGone when the connection to Chrome is lost.
    """
    results: dict[int, T | Failure] = {}
    waits: dict[int, Wait] = {}
    for tab, routine in routines.items():
        _advance(tab, routine, None, waits, results)
    while waits:
        now = time.monotonic()
        moved = False
        for tab, wait in list(waits.items()):
            ready = wait.ready()
            if ready or now >= wait.deadline:
                moved = True
                _advance(tab, routines[tab], ready, waits, results)
        if not moved:
            until = min(wait.deadline for wait in waits.values())
            if any(wait.polls for wait in waits.values()):
                until = min(until, now + POLL_S)
            tools.pump(until)
    return results


def _advance(
    tab: int, routine: Routine[T], ready: bool | None, waits: dict[int, Wait], results: dict[int, T | Failure]
) -> None:
    """Go on with a routine until it waits again or ends."""
    waits.pop(tab, None)
    try:
        waits[tab] = next(routine) if ready is None else routine.send(ready)
    except StopIteration as stop:
        results[tab] = stop.value
    except TabFailed as error:
        results[tab] = error.failure
