"""When a page is quiet: nothing is loading and nothing has changed for a while."""

from __future__ import annotations

import json
import time
from typing import Any

from browser_farm.sites.routines import Routine, TabFailed, Wait
from browser_farm.sites.session import Session
from browser_farm.sites.task_file import WaitRule

SHOWN_REQUESTS = 2  # in a message


def settle(session: Session, rule: WaitRule, first_ref: int, most: int) -> Routine[list[Any] | None]:
    """Wait until network and page are quiet; the columns of the page, or None if a dialog is open."""
    deadline, quiet_s = time.monotonic() + rule.deadline_s, rule.quiet_ms / 1000
    ask = f"giirl.observe({json.dumps([rule.quiet_ms, first_ref, most, ','.join(rule.ignore_elements)])[1:-1]})"

    def loading() -> list[str]:
        return session.traffic.under_way(rule.ignore_addresses)

    def interrupted() -> bool:
        return session.dialog is not None or session.crashed

    while True:
        if session.crashed:
            raise TabFailed("tab_crashed")
        if session.dialog is not None:
            return None
        if session.is_broken:
            raise TabFailed("unreachable", f"{session.address} did not answer")
        if time.monotonic() >= deadline:
            raise TabFailed("not_quiet", (yield from _restless(session, rule)))
        quiet_at = session.traffic.active_s + quiet_s
        if loading():
            yield Wait(lambda: interrupted() or not loading(), deadline)
        elif time.monotonic() < quiet_at:
            yield Wait(interrupted, min(deadline, quiet_at))
        else:
            text = yield from session.evaluate(ask)
            answer = json.loads(text) if isinstance(text, str) else None
            if isinstance(answer, list) and not loading():
                return answer
            left_s = answer / 1000 if isinstance(answer, int | float) else quiet_s
            yield Wait(interrupted, min(deadline, time.monotonic() + left_s))


def _restless(session: Session, rule: WaitRule) -> Routine[str]:
    """Why the page is not quiet."""
    if waiting := session.traffic.under_way(rule.ignore_addresses):
        why = f"requests are under way: {', '.join(waiting[:SHOWN_REQUESTS])}"
    else:
        why = f"{(yield from session.evaluate('giirl.restless()'))} keeps changing"
    return f"{session.address} was not quiet within {rule.deadline_s:g} s: {why}"
