"""The actor and reward-service processes of a run: started, replaced, resized and ended from the learner's process."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

from actors.episode_counter import counter_file, read_counts
from actors.pool import actor_place
from actors.process import ActorProcess
from giirl.run.folder import RunFolder
from giirl_core.algorithms import ALGORITHMS
from giirl_core.config import Config
from giirl_core.config_file import dump_config
from giirl_core.metrics import Metrics
from giirl_core.processes.broadcast import Broadcast
from giirl_core.processes.open_files import raise_open_files
from giirl_core.processes.supervision import START_TIMEOUT_S, Call, Place, Platform, Process, SupervisedProcess
from giirl_core.processes.waiting import WaitingNotice
from giirl_core.telemetry.series import WORKER_STATES, WORKERS
from learner.stream.ingest import Ingest
from reward_service.process import RewardProcess

LOG = logging.getLogger(__name__)
POLL_S = 0.5  # between two checks of the processes
STOP_TIMEOUT_S = 10.0  # for actors to send their finished episodes, and processes to end
PING_S = 10.0  # between two signs of life to processes that hear nothing else
FORGET_TIMEOUT_S = 2.0  # for the actors to delete their temporary files
LEAVE_TIMEOUT_S = 60.0  # for a surplus actor to wait until a checkpoint covers all its episodes


class Fleet:
    """All processes of a run. `poll` keeps them healthy; it has to be called often.

    `episodes_taken` returns how many episodes the learner has taken; `incarnation` is larger than that of any actor
    before.
    """

    def __init__(
        self,
        config: Config,
        folder: RunFolder,
        platform: Platform,
        ingest: Ingest,
        encrypted: bool,
        metrics: Metrics,
        *,
        incarnation: int,
        episodes_taken: Callable[[], int],
    ) -> None:
        self._config, self._folder, self._platform, self._ingest = config, folder, platform, ingest
        self._encrypted, self._metrics, self._episodes_taken = encrypted, metrics, episodes_taken
        self._incarnation = incarnation
        self._policy: Any = None  # weights, as the platform shares them
        self._reward: Any = None
        self._target = folder.wanted_actors() or config.actors.count
        self._replicas = config.scoring.replicas if ALGORITHMS[config.algorithm].has_learned_reward else 0
        self._services: list[SupervisedProcess] = []
        self._actors: list[SupervisedProcess] = []
        self._surplus: list[tuple[SupervisedProcess, float]] = []  # actors that leave, with their deadlines
        self._refused = 0  # actors that `giirl actors` asked for in vain
        self._places = places(config)
        # On a cluster each actor counts its episodes in a temporary folder on its node.
        self._counts = folder.actors.absolute() if platform.single_node else None
        self._broadcast = Broadcast()  # of policy weights, to the actors
        self._clients: dict[str, str] = {}  # public key of each actor, by name
        self._scorers: list[str] = []
        self._polled_s = self._pinged_s = float("-inf")
        self._notice = WaitingNotice(lambda kind: str(self._places[kind]), platform.resources)

    @property
    def starting(self) -> bool:
        """Whether a process is still starting."""
        return any(member.running is None and not member.quarantined for member in self._members)

    @property
    def waits_for_place(self) -> bool:
        """True while nobody can play, because no node has room for an actor."""
        return bool(self._actors) and all(actor.state in ("waiting", "given_up") for actor in self._actors)

    def load(self, policy: Any, reward: Any) -> None:
        """Send new weights to all processes. The first call starts the reward services, and `poll` then the actors."""
        self._policy, self._reward = policy, reward
        if not self._services:
            self._services = [self._start_service(index) for index in range(self._replicas)]
        for service in self._services:
            service.load(reward)
        self._broadcast.send(policy, [actor.process for actor in self._actors if actor.running is not None])
        self.poll()

    def poll(self) -> None:
        """Restart what ended, replace what hangs, start and stop actors; RuntimeError when too few stay up."""
        for member in self._members:
            member.poll()
        if time.monotonic() - self._polled_s < POLL_S:
            return
        self._polled_s = time.monotonic()
        self._announce_scorers()
        for actor in self._actors:
            self._replace_if_silent(actor)
            if actor.quarantined and not actor.stopping:
                actor.stopping = True
                self._retire(actor.name)
        for service in self._services:
            if service.load_pending_s > self._config.actors.heartbeat_timeout_s:
                service.replace(service.load_pending_s, heartbeat_received=True)
        self._resize()
        self._check_health()
        self._count_workers()
        self._notice.update(self._members)
        self._ping()

    def retire_unknown(self, actors: Sequence[str]) -> None:
        """Count out those actors of an earlier session that this one does not start again."""
        for name in actors:
            if name not in {f"actor-{index}" for index in range(self._target)}:
                self._retire(name)

    def addresses(self) -> dict[str, str]:
        """The metrics address of each process that is up, by its name."""
        return {member.name: member.addresses[0] for member in self._members if member.addresses}

    def describe_trouble(self) -> str:
        """Which processes do not work, and why; "" when all work."""
        idle = [f"{m.name}: {m.last_error}" for m in self._members if m.running is None or not m.heartbeat_received]
        return f"; {'; '.join(idle[:4])}; free: {self._platform.resources()}" if idle else ""

    def drain(self) -> None:
        """Let the actors send their finished episodes and end."""
        for actor in self._actors:
            actor.stopping = True
            actor.notify("stop", 0.0)
        _wait_until_ended(self._actors)
        for actor in self._actors:
            self._retire(actor.name)

    def stop(self) -> None:
        """Drain, end the reward services, and kill what has not ended in time."""
        self._broadcast.close()
        self.drain()
        for service in self._services:
            service.stopping = True
            service.notify("stop")
        _wait_until_ended(self._services)
        for member in self._members:
            member.process.kill()

    def forget(self) -> None:
        """A checkpoint covers all episodes of the actors, which have ended: delete their counts on their nodes."""
        ended = [actor for actor in self._actors if actor.running is not None and actor.running.done()]
        calls = [actor.process.call("forget") for actor in ended]
        deadline_s = time.monotonic() + FORGET_TIMEOUT_S
        while not all(call.done() for call in calls) and time.monotonic() < deadline_s:
            time.sleep(0.05)

    @property
    def _members(self) -> list[SupervisedProcess]:
        return [*self._actors, *self._services, *(actor for actor, _ in self._surplus)]

    def _start_service(self, index: int) -> SupervisedProcess:
        name = f"reward-service-{index}"
        values = (dump_config(self._config), self._folder.identity, name, self._encrypted)

        def start() -> Process:
            return self._platform.start(RewardProcess, name, *values, place=self._places["reward-service"])

        def start_run(process: Process, addresses: tuple[str, str]) -> Call:
            return process.call(_method(process), self._reward, tuple(self._clients.values()))

        return SupervisedProcess(
            name, start, start_run, self._metrics, place_timeout_s=self._config.actors.place_timeout_s
        )

    def _start_actor(self, index: int) -> SupervisedProcess:
        name = f"actor-{index}"
        values = (dump_config(self._config), self._folder.identity, index, self._counts, self._encrypted)

        def start() -> Process:
            return self._platform.start(ActorProcess, name, *values, place=self._places["actor"])

        def start_run(process: Process, addresses: tuple[str, str]) -> Call:
            self._incarnation += 1
            self._admit(name, addresses[1])
            first, scorers = self._episodes_taken(), tuple(self._scorers)
            method = _method(process)
            return process.call(method, self._incarnation, first, self._ingest.address, scorers, self._policy)

        return SupervisedProcess(
            name, start, start_run, self._metrics, place_timeout_s=self._config.actors.place_timeout_s
        )

    def _admit(self, actor: str, public_key: str) -> None:
        """Let the learner and the reward services accept connections with this key."""
        if public_key:
            self._clients[actor] = public_key
            self._ingest.allow([key.encode() for key in self._clients.values()])
            for service in self._services:
                service.notify("allow", tuple(self._clients.values()))

    def _retire(self, actor: str) -> None:
        """Count out an actor that will not come back, by its own count if its file can be read from here."""
        self._ingest.retire(actor, read_counts(counter_file(self._counts, self._folder.identity, actor)))

    def _announce_scorers(self) -> None:
        """Tell the actors when the addresses of the reward services have changed."""
        scorers = [service.addresses[1] for service in self._services if service.addresses]
        if scorers != self._scorers:
            self._scorers = scorers
            for actor in self._actors:
                actor.notify("set_scorers", tuple(scorers))

    def _replace_if_silent(self, actor: SupervisedProcess) -> None:
        if actor.running is None or actor.quarantined:
            return
        running_s, silent_s = time.monotonic() - actor.since_s, self._ingest.silent_for_s(actor.name)
        actor.heartbeat_received = silent_s < running_s
        timeout_s = self._config.actors.heartbeat_timeout_s + (0.0 if actor.heartbeat_received else START_TIMEOUT_S)
        if min(running_s, silent_s) > timeout_s:
            actor.replace(timeout_s, heartbeat_received=actor.heartbeat_received)

    def _resize(self) -> None:
        """Start or stop actors until there are as many as `giirl actors` asked for, or else the config."""
        self._target = self._affordable(self._folder.wanted_actors() or self._target)
        leaving = {actor.name for actor, _ in self._surplus}
        while len(self._actors) < self._target and f"actor-{len(self._actors)}" not in leaving:
            self._actors.append(self._start_actor(len(self._actors)))
        while len(self._actors) > self._target:
            actor = self._actors.pop()
            actor.stopping = True
            actor.notify("stop", LEAVE_TIMEOUT_S)
            self._surplus.append((actor, time.monotonic() + LEAVE_TIMEOUT_S + STOP_TIMEOUT_S))
        for actor, deadline_s in list(self._surplus):
            if actor.running is None or actor.running.done() or time.monotonic() > deadline_s:
                actor.process.kill()
                self._surplus.remove((actor, deadline_s))
                self._retire(actor.name)

    def _affordable(self, wanted: int) -> int:
        """How many of the wanted actors to have: the present number if more would need too many open files."""
        if wanted > self._target and wanted != self._refused:
            try:
                raise_open_files(wanted)
            except ValueError as error:
                LOG.error("the number of actors stays %d: %s", self._target, error)
                self._refused = wanted
        return self._target if wanted == self._refused else wanted

    def _count_workers(self) -> None:
        """Show how many processes are in which state."""
        members = [*self._services, *self._actors, *(actor for actor, _ in self._surplus)]
        counts = Counter((member.kind, member.state) for member in members)
        for kind, state in product(WORKERS, WORKER_STATES):
            self._metrics.workers.labels(kind, state).set(counts[kind, state])

    def _ping(self) -> None:
        """Show the reward services that there is a learner; the actors hear its socket."""
        if time.monotonic() - self._pinged_s > PING_S:
            self._pinged_s = time.monotonic()
            for service in self._services:
                service.notify("ping")

    def _check_health(self) -> None:
        if self._services and not any(service.healthy for service in self._services):
            raise RuntimeError(f"no reward service stays up: {self._services[0].quarantine_reason}")
        healthy = [actor for actor in self._actors if actor.healthy]
        if len(healthy) < min(self._config.actors.min_healthy, self._target):
            trouble = next(actor.quarantine_reason for actor in self._actors if actor.quarantined)
            raise RuntimeError(
                f"{len(healthy)} of {len(self._actors)} actors are left, "
                f"wanted {self._config.actors.min_healthy} (actors.min_healthy): {trouble}"
            )


def places(config: Config) -> dict[str, Place]:
    """What a process asks of its node, by kind."""
    scoring = config.scoring
    return {
        "actor": actor_place(config),
        "reward-service": Place(cpus=scoring.cpus, memory_bytes=round(scoring.memory_mb * 1e6), apart=True),
    }


def _method(process: Process) -> str:
    """The method that starts a run: "rejoin" if an earlier learner started the process and it may still run."""
    return "rejoin" if process.reattached else "run"


def _wait_until_ended(members: Sequence[SupervisedProcess]) -> None:
    """Wait for the calls of these processes to return, at most STOP_TIMEOUT_S."""
    deadline_s = time.monotonic() + STOP_TIMEOUT_S
    while any(member.running is not None and not member.running.done() for member in members):
        if time.monotonic() > deadline_s:
            return
        time.sleep(0.05)
