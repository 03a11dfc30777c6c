"""A process that plays pages for demonstrations and evaluation, in a browser of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import closing

from actors.browser import open_browser
from actors.player import AgentSpec, BrowserPlayer
from giirl_core.processes.worker_process import TICK_S, WorkerProcess
from giirl_core.telemetry.series import ACTOR
from giirl_core.types import Purpose
from giirl_core.wire.messages import Stamp, encode_episode

NO_STAMP = Stamp(run="", actor="", incarnation=0, sequence=0)  # these episodes are no stream


class PlayerProcess(WorkerProcess):
    """`run` keeps the browser open and blocks its thread until `stop`; `play` is called from another thread."""

    KIND = ACTOR

    def __init__(self, config: str, run: str, name: str) -> None:
        self._player: BrowserPlayer | None = None
        self._playing = threading.Lock()
        super().__init__(config, run, name, encrypted=False)  # last, because it starts threads

    def addresses(self) -> tuple[str, str]:
        """The address of the metrics, and "" because a player serves nothing else."""
        return self.metrics_address(), ""

    def run(self) -> None:
        """Open the browser and keep it until stopped."""
        self.ping()
        self._running = True
        try:
            with closing(open_browser(self._config, self._metrics)) as browser:
                self._player = BrowserPlayer(self._config, browser, self._metrics)
                while not self._stopped.wait(TICK_S):
                    continue
                with self._playing:  # the last call has to end before its browser closes
                    self._player = None
        finally:
            self._running = False

    def play(self, spec: AgentSpec, purpose: Purpose, pages: int, tasks: Sequence[str], first: int) -> list[bytes]:
        """The encoded episodes of pages of each task; see `Player.play`."""
        self.ping()
        while self._player is None and not self._stopped.is_set():  # `run` opens the browser, or fails
            time.sleep(TICK_S)
        with self._playing:
            player = self._player
            if player is None:
                raise RuntimeError("this process has been stopped")
            episodes = player.play(spec, purpose, pages, tasks=tasks, first=first)
            return [encode_episode(episode, stamp=NO_STAMP) for episode in episodes]

    def stop(self) -> None:
        """Make `run` close the browser and return."""
        self.ping()
        self._stopped.set()
