"""The actions of an environment as those of the agents of this project: clicks on elements, and words of the goal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import NO_ELEMENT, NO_REF, NO_SPAN, Action, Command, Goal, Page, Verb


def agent_action(command: Command, page: Page, goal: Goal) -> Action | None:
    """The click or the typing that has the effect of a command on a page; None if no such action has it.

    A click at a point is one on the last element there. Text is typed at the end of a field, which an agent replaces:
    both are alike in an empty field.
    """
    if command.verb is Verb.CLICK or (command.verb is Verb.ACTIVATE and not command.text):
        row = _row_of(command.ref, page) if command.ref != NO_REF else _row_at(command.at, page)
        return None if row == NO_ELEMENT else Action(verb=Verb.CLICK, element=row)
    if command.verb not in (Verb.ACTIVATE, Verb.APPEND):
        return None
    row = _row_of(command.ref, page) if command.ref != NO_REF else _last(page.focused)
    start, end = goal.find(command.text)
    if row == NO_ELEMENT or start == NO_SPAN or not page.typable[row] or page.value[row]:
        return None
    return Action(verb=Verb.TYPE, element=row, start=start, end=end)


def _row_of(ref: int, page: Page) -> int:
    return _last(page.ref == ref)


def _row_at(point: tuple[float, float], page: Page) -> int:
    left_top = page.box[:, :2]
    inside = (left_top <= point) & (point < left_top + page.box[:, 2:])
    return _last(np.asarray(inside.all(axis=1)))


def _last(rows: NDArray[np.bool_]) -> int:
    """The last row that is True; NO_ELEMENT without one."""
    found = np.flatnonzero(rows)
    return int(found[-1]) if len(found) else NO_ELEMENT
