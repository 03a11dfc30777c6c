"""Actors and reward services as processes of their own, seen from the learner, which stays in this one.

Trajectories and scores go over sockets (`giirl_core.wire.transport`), weights through the platform that runs the
processes.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

from actors.episode_counter import read_counts
from actors.process import ActorProcess
from giirl.run.folder import RunFolder
from giirl_core.config import Config
from giirl_core.config_file import dump_config
from giirl_core.metrics import Metrics
from giirl_core.processes.supervision import START_TIMEOUT_S, Call, Platform, Process, SupervisedProcess
from giirl_core.types import Episode, Weights
from giirl_core.wire.transport import Keys
from learner.stream.admission import IngestLimits
from learner.stream.ingest import Ingest
from learner.stream.snapshot import IngestSnapshot
from reward_service.process import RewardProcess

STOP_S = 10.0  # for processes to hand over and end
LEAVE_S = 60.0  # for an actor that is removed to see a checkpoint cover all it played
TEND_S = 0.5  # between two looks at the processes
WATCH_S = 0.05  # the same while one of them is on its way up
RUNTIME = "runtime.json"  # of a checkpoint


class WorkersRuntime:
    """The processes of one run."""

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
        self._config, self._folder, self._platform = config, folder, platform
        self._metrics, self._stop, self._save_now = metrics, stop, save
        self._version = 0
        self._policy: Any = None
        self._reward: Any = None
        self._held = IngestSnapshot.load(resume) if resume else IngestSnapshot()
        self._taken: int = json.loads((resume / RUNTIME).read_text())["taken"] if resume else 0
        known = [offsets.incarnation for offsets in self._held.offsets]
        self._incarnation = max([int(time.time()), *(incarnation + 1 for incarnation in known)])  # they only grow
        self._keys = (
            None if platform.single_node else Keys.load_or_create(folder.keys)
        )  # beyond loopback nobody talks without them
        self._ingest = Ingest(
            folder.identity,
            lambda: self._version,
            reward_version=lambda: self._version,
            host=platform.host,
            limits=IngestLimits(credits=config.stream.credits, max_lag=config.stream.policy_lag),
            keys=self._keys,
            metrics=metrics,
            snapshot=self._held,
            held_out=config.held_out_goals,
        )
        self._wanted = folder.wanted_actors() or config.actors.count
        for mark in self._held.offsets:  # of actors that nobody wants any more
            if mark.actor not in {f"actor-{index}" for index in range(self._wanted)}:
                self._ingest.retire(mark.actor, read_counts(self._tally(mark.actor)))
        self._services: list[SupervisedProcess] = []
        self._actors: list[SupervisedProcess] = []
        self._leavers: list[tuple[SupervisedProcess, float]] = []
        self._scorers: list[str] = []
        self._tended_s = float("-inf")

    def publish(self, policy: Weights, reward: Weights) -> None:
        """Hand new weights to everybody; the first ones start the processes."""
        self._version = policy.version
        self._policy, self._reward = self._platform.share(policy), self._platform.share(reward)
        if not self._services:
            self._services = [self._start_service(index) for index in range(self._config.scoring.replicas)]
        for service in self._services:
            service.load(self._reward)
        for actor in self._actors:
            actor.load(self._policy)
        self._tend()

    def take(self, episodes: int) -> list[Episode]:
        """The next `episodes` that the actors finished; none when the run should end.

        In lock-step a few more, so that every task has equally many.
        """
        if self._config.stream.policy_lag == 0:
            episodes = self._config.quota * len(self._config.tasks)
        timeout_s = self._config.stream.take_timeout_s
        deadline_s = time.monotonic() + timeout_s
        while not self._stop.is_set():
            self._tend()
            if self._ingest.wants_commit:
                self._save_now()
            try:
                rising = any(member.running is None and not member.quarantined for member in self._members)
                taken = self._ingest.take(episodes, WATCH_S if rising else TEND_S)
            except TimeoutError as error:
                if time.monotonic() > deadline_s:
                    raise RuntimeError(
                        f"fewer than {episodes} episodes came within {timeout_s:.0f} s (stream.take_timeout_s): "
                        f"{error}{self._troubles()}"
                    ) from None
            else:
                self._taken += len(taken)
                return taken
        return []

    def addresses(self) -> dict[str, str]:
        """Where each process answers scrapes, as far as known."""
        return {member.name: member.addresses[0] for member in self._members if member.addresses}

    def save(self, folder: Path) -> None:
        """What the learner has accepted and not used yet, and what it has seen of every actor."""
        self._held = self._ingest.snapshot()
        self._held.save(folder)
        (folder / RUNTIME).write_text(json.dumps({"taken": self._taken}))

    def committed(self) -> None:
        """The last `save` is safe on the disk: actors may forget what it covers."""
        self._ingest.commit(self._held)

    def drain(self) -> None:
        """Let the actors hand over what they have finished, and end."""
        for actor in self._actors:
            actor.stopping = True
            actor.notify("stop", 0.0)
        self._outlast(self._actors, STOP_S)
        for actor in self._actors:
            self._bury(actor)

    def close(self) -> None:
        """Let the processes end; whoever does not in time is ended."""
        self.drain()
        for service in self._services:
            service.stopping = True
            service.notify("stop")
        self._outlast(self._services, STOP_S)
        try:
            for member in self._members:
                member.process.kill(restart=False)
            self._ingest.close()
        finally:
            self._platform.close()

    @property
    def _members(self) -> list[SupervisedProcess]:
        return [*self._actors, *self._services, *(leaver for leaver, _ in self._leavers)]

    def _start_service(self, index: int) -> SupervisedProcess:
        name = f"reward-service-{index}"
        process = self._platform.start(RewardProcess, name, dump_config(self._config), self._keys, cpus=0)

        def begin(process: Process, restarts: int) -> Call:
            return process.call("rejoin" if process.reattached and not restarts else "run", self._reward)

        return SupervisedProcess(name, process, begin, self._metrics)

    def _start_actor(self, index: int) -> SupervisedProcess:
        name = f"actor-{index}"
        words = (dump_config(self._config), self._folder.identity, index, str(self._tally(name)), self._keys)
        process = self._platform.start(ActorProcess, name, *words, cpus=1)

        def begin(process: Process, restarts: int) -> Call:
            method = "rejoin" if process.reattached and not restarts else "run"
            self._incarnation += 1
            return process.call(
                method, self._incarnation, self._taken, self._ingest.address, tuple(self._scorers), self._policy
            )

        return SupervisedProcess(name, process, begin, self._metrics)

    def _tally(self, name: str) -> Path:
        """Where an actor counts: where nodes share no folder, on its own, for whoever comes after it there."""
        run = self._folder
        shared = (
            run.path / "actors" if self._platform.single_node else Path(tempfile.gettempdir()) / "giirl" / run.identity
        )
        return shared.absolute() / f"{name}.tally"

    def _bury(self, actor: SupervisedProcess) -> None:
        """It is gone for good: what it took along is counted, by its own count where that can be read from here."""
        self._ingest.retire(actor.name, read_counts(self._tally(actor.name)))

    def _tend(self) -> None:
        """Start again what ended, replace what hangs, follow who comes and goes; too few actors end the run."""
        for member in self._members:
            member.poll()
        if time.monotonic() - self._tended_s < TEND_S:
            return
        self._tended_s = time.monotonic()
        scorers = [service.addresses[1] for service in self._services if service.addresses]
        if scorers != self._scorers:
            self._scorers = scorers
            for actor in self._actors:
                actor.notify("set_scorers", tuple(scorers))
        for actor in self._actors:
            self._replace_if_silent(actor)
            if actor.quarantined and not actor.stopping:
                actor.stopping = True
                self._bury(actor)
        for service in self._services:
            if service.load_pending_s > self._config.actors.heartbeat_timeout_s:
                service.replace(service.load_pending_s, heartbeat_received=True)
        self._resize()
        self._check_health()

    def _replace_if_silent(self, actor: SupervisedProcess) -> None:
        if actor.running is None or actor.quarantined:
            return
        begun_s, silent_s = time.monotonic() - actor.since_s, self._ingest.silent_for_s(actor.name)
        actor.heartbeat_received = silent_s < begun_s
        patience_s = self._config.actors.heartbeat_timeout_s + (0.0 if actor.heartbeat_received else START_TIMEOUT_S)
        if min(begun_s, silent_s) > patience_s:
            actor.replace(patience_s, heartbeat_received=actor.heartbeat_received)

    def _resize(self) -> None:
        """As many actors as are wanted: the config's number, or what was asked for since."""
        self._wanted = self._folder.wanted_actors() or self._wanted
        going = {leaver.name for leaver, _ in self._leavers}
        while len(self._actors) < self._wanted and f"actor-{len(self._actors)}" not in going:
            self._actors.append(self._start_actor(len(self._actors)))
        while len(self._actors) > self._wanted:
            leaver = self._actors.pop()
            leaver.stopping = True
            leaver.notify("stop", LEAVE_S)
            self._leavers.append((leaver, time.monotonic() + LEAVE_S + STOP_S))
        for leaver, deadline_s in list(self._leavers):
            if leaver.running is None or leaver.running.done() or time.monotonic() > deadline_s:
                leaver.process.kill(restart=False)
                self._leavers.remove((leaver, deadline_s))
                self._bury(leaver)
        self._metrics.healthy_workers.labels("actor").set(sum(actor.healthy for actor in self._actors))
        self._metrics.healthy_workers.labels("reward-service").set(sum(service.healthy for service in self._services))

    def _check_health(self) -> None:
        if not any(service.healthy for service in self._services):
            raise RuntimeError(f"no reward service stays up: {self._services[0].quarantine_reason}")
        healthy = [actor for actor in self._actors if actor.healthy]
        if len(healthy) < min(self._config.actors.min_healthy, self._wanted):
            trouble = next(actor.quarantine_reason for actor in self._actors if actor.quarantined)
            raise RuntimeError(
                f"{len(healthy)} of {len(self._actors)} actors are left, "
                f"wanted {self._config.actors.min_healthy} (actors.min_healthy): {trouble}"
            )

    def _troubles(self) -> str:
        """Who does not work, and why."""
        idle = [f"{m.name}: {m.last_error}" for m in self._members if m.running is None or not m.heartbeat_received]
        return f"; {'; '.join(idle[:4])}; there are {self._platform.resources()}" if idle else ""

    def _outlast(self, members: list[SupervisedProcess], timeout_s: float) -> None:
        deadline_s = time.monotonic() + timeout_s
        while any(member.running is not None and not member.running.done() for member in members):
            if time.monotonic() > deadline_s:
                return
            time.sleep(0.05)
