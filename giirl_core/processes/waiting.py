"""Says that processes wait for a place in the cluster: once when it begins, now and then while it lasts, at its end."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping, Sequence

from giirl_core.processes.supervision import SupervisedProcess

LOG = logging.getLogger(__name__)
PATIENCE_S = 15.0  # to wait before it is said; starting a process takes a few seconds
REPEAT_S = 600.0  # between two messages while the wait goes on


class WaitingNotice:
    """Watches which processes of a run wait for a place.

    `needs` returns what one of them asks for, `free` what the cluster has.
    """

    def __init__(self, needs: Callable[[str], str], free: Callable[[], str]) -> None:
        self._needs, self._free = needs, free
        self._since_s: float | None = None  # start of the wait
        self._said_s: float | None = None  # time of the last message about it

    def update(self, members: Sequence[SupervisedProcess]) -> None:
        """Log a line if one is due."""
        waiting = [member for member in members if member.state == "waiting"]
        now_s = time.monotonic()
        if not waiting:
            if self._said_s is not None and self._since_s is not None:
                LOG.warning("all processes have a place, after %.0f s", now_s - self._since_s)
            self._since_s = self._said_s = None
            return
        self._since_s = self._since_s or now_s
        due_s = self._since_s + PATIENCE_S if self._said_s is None else self._said_s + REPEAT_S
        if now_s < due_s:
            return
        self._said_s = now_s
        first, more = waiting[0], f" and {len(waiting) - 1} more" if len(waiting) > 1 else ""
        LOG.warning(
            "%s%s of %d processes waited %.0f s for a place so far: %s asks for %s, free are %s; "
            "add a node, or end what uses them: giirl clean",
            first.name, more, len(members), now_s - self._since_s, first.name, self._needs(first.kind), self._free(),
        )  # fmt: skip


def describe_free(free: Mapping[str, float], there: Mapping[str, float]) -> str:
    """What is free of the resources that a process can ask for."""
    parts = []
    for name, total in sorted({"CPU": 0.0, **there}.items()):
        if name == "memory":
            parts.append(f"{free.get(name, 0) / 1e6:.0f} of {total / 1e6:.0f} MB of memory")
        elif ":" not in name and name != "object_store_memory":
            parts.append(f"{free.get(name, 0):g} of {total:g} {name}")
    return ", ".join(parts)
