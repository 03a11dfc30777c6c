"""Whether a process is alive and ready, as `/healthz` and `/readyz` answer it."""

from __future__ import annotations

import time

HUNG_S = 300.0  # a main loop that has not moved for this long is reported as hung


class Health:
    """The state of one process. Thread-safe: every change is one assignment."""

    def __init__(self) -> None:
        self._waiting_for = "it is starting"
        self._beat_s: float | None = None

    def ready(self) -> None:
        """The process does its work from now on."""
        self._waiting_for = ""

    def not_ready(self, reason: str) -> None:
        """The process does not do its work, for this reason; its main loop rests."""
        self._waiting_for, self._beat_s = reason, None

    def beat(self) -> None:
        """The main loop moves. From the first beat on it has to beat again within HUNG_S."""
        self._beat_s = time.monotonic()

    @property
    def hung(self) -> str:
        """Why the process counts as hung; "" if it does not."""
        beat_s = self._beat_s
        if beat_s is None or (silent_s := time.monotonic() - beat_s) <= HUNG_S:
            return ""
        return f"the main loop has not moved for {silent_s:.0f} s, wanted {HUNG_S:.0f}"

    @property
    def unready(self) -> str:
        """Why the process does not do its work; "" if it does."""
        return self.hung or self._waiting_for
