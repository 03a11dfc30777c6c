"""The local and ray runtimes: actors and reward services as processes of their own, the learner in this one.

Trajectories and scores go over sockets (`giirl_core.wire.transport`), weights through the platform that runs the
processes (`giirl.run.fleet`).
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event

from giirl.run.fleet import POLL_S, Fleet
from giirl.run.folder import RUNTIME_FILE, RunFolder
from giirl.throughput import StreamState
from giirl_core.config import Config
from giirl_core.gestures import read_gestures
from giirl_core.metrics import Metrics
from giirl_core.processes.supervision import Platform
from giirl_core.types import Episode
from giirl_core.weights import Weights
from giirl_core.wire.key_file import load_or_create_keys
from learner.stream.flow import IngestLimits
from learner.stream.ingest import Ingest
from learner.stream.snapshot import IngestSnapshot

STARTING_POLL_S = 0.05  # between two checks of the processes while one is starting


class WorkersRuntime:
    """The stream of episodes from the actors of a run to its learner."""

    def __init__(
        self,
        config: Config,
        folder: RunFolder,
        platform: Platform,
        metrics: Metrics,
        stop: Event,
        resume: Path | None,
        save: Callable[[], None],
    ) -> None:
        self._config, self._platform, self._stop, self._save_now = config, platform, stop, save
        self.node, self._health = platform.node, metrics.health
        self._version = 0
        self._snapshot = IngestSnapshot.load(resume) if resume else IngestSnapshot()
        self._taken: int = json.loads((resume / RUNTIME_FILE).read_bytes())["taken"] if resume else 0
        # Connections beyond this machine are encrypted.
        keys = None if platform.single_node else load_or_create_keys(folder.keys)
        self._ingest = Ingest(
            folder.identity,
            lambda: self._version,
            reward_version=lambda: self._version,
            host=platform.host,
            limits=IngestLimits(
                credits=config.stream.credits, batch=config.rollout_batch, max_lag=config.stream.policy_lag
            ),
            keys=keys,
            metrics=metrics,
            snapshot=self._snapshot,
            held_out=config.held_out_goals,
            gestures=read_gestures(config.net.gestures),
        )
        self._stale_before = self._ingest.stale  # in earlier sessions of a resumed run
        known = max((offsets.incarnation for offsets in self._snapshot.offsets), default=0)
        self._fleet = Fleet(
            config,
            folder,
            platform,
            self._ingest,
            not platform.single_node,
            metrics,
            incarnation=folder.reserve_incarnations(above=known),
            episodes_taken=lambda: self._taken,
        )
        self._fleet.retire_unknown([offsets.actor for offsets in self._snapshot.offsets])

    def publish(self, policy: Weights, reward: Weights) -> None:
        """Send new weights to all processes; the first weights start them."""
        self._version = policy.version
        self._fleet.load(self._platform.share(policy), self._platform.share(reward))

    def take(self, episodes: int) -> list[Episode]:
        """The next `episodes` that the actors finished; an empty list when the run should stop.

        In lock-step it is a few more, so that there are equally many of every task. RuntimeError when none comes for
        `stream.take_timeout_s`; the time in which no node has room for an actor does not count.
        """
        if self._config.stream.policy_lag == 0:
            episodes = self._config.quota * len(self._config.tasks)
        timeout_s = self._config.stream.take_timeout_s
        deadline_s, most_queued = time.monotonic() + timeout_s, 0
        while not self._stop.is_set():
            self._health.beat()
            self._fleet.poll()
            queued = self._ingest.queued
            if queued > most_queued or self._fleet.waits_for_place:
                deadline_s, most_queued = time.monotonic() + timeout_s, queued
            if self._ingest.wants_commit:
                self._save_now()
            try:
                taken = self._ingest.take(episodes, STARTING_POLL_S if self._fleet.starting else POLL_S)
            except TimeoutError as error:
                if time.monotonic() > deadline_s:
                    raise RuntimeError(
                        f"no episode came for {timeout_s:.0f} s (stream.take_timeout_s), wanted {episodes}: "
                        f"{str(error).partition(': ')[2]}{self._fleet.describe_trouble()}"
                    ) from None
            else:
                self._taken += len(taken)
                return taken
        return []

    def stream(self) -> StreamState:
        """How many episodes were dropped as stale, and how much of their time the actors' tabs are idle."""
        ingest = self._ingest
        return StreamState(stale=ingest.stale - self._stale_before, queued=ingest.queued, actors_idle=ingest.idle_share)

    def addresses(self) -> dict[str, str]:
        """The metrics address of each process that is up, by its name."""
        return self._fleet.addresses()

    def save(self, folder: Path) -> None:
        """Write the episodes that were accepted and not used yet, and the position in every actor's stream."""
        self._snapshot = self._ingest.snapshot()
        self._snapshot.save(folder)
        (folder / RUNTIME_FILE).write_text(json.dumps({"taken": self._taken}), encoding="utf-8")

    def committed(self) -> None:
        """The last `save` is on the disk: actors may delete the episodes that it covers."""
        self._ingest.commit(self._snapshot)

    def forget(self) -> None:
        """The last `save` covers everything that was played: delete what only another session would need."""
        self._fleet.forget()

    def drain(self) -> bool:
        """Let the actors send their finished episodes and end."""
        self._fleet.drain()
        return True

    def close(self) -> None:
        """End all processes; those that do not end in time are killed."""
        try:
            self._fleet.stop()
            self._ingest.close()
        finally:
            self._platform.close()
