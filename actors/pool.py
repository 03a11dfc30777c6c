"""Plays pages on all nodes of a cluster: shares of them go to processes, and a share whose process died is repeated."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial

from actors.player import AgentSpec, OpenPlayer, open_browser_player
from actors.player_process import PlayerProcess
from giirl_core.config import Config
from giirl_core.config_file import dump_config
from giirl_core.metrics import Metrics
from giirl_core.processes.supervision import Call, Place, Platform, Process, ProcessDied, SupervisedProcess
from giirl_core.processes.waiting import WaitingNotice
from giirl_core.progress import Job
from giirl_core.types import Episode, Purpose
from giirl_core.wire.messages import build_episode, decode

POLL_S = 0.05
PING_S = 10.0  # between two signs of life of this process
SHARES_PER_PROCESS = 4  # so that a slow process does not keep the others waiting
SHARE_TIMEOUT_S = 900.0  # a process that needs longer for its share is replaced
MAX_TRIES = 3  # of one share


def player_for(config: Config, run: str) -> OpenPlayer:
    """What plays demonstrations and evaluation: a browser in this process, or on a cluster processes on all nodes.

    `run` is the identity of the run.
    """
    return partial(open_pool, run=run) if config.runtime == "ray" else open_browser_player


@contextmanager
def open_pool(config: Config, metrics: Metrics, *, run: str) -> Iterator[PagePool]:
    """A pool on the Ray cluster that this machine belongs to. `run` is the identity of the run."""
    from giirl_core.processes.ray_platform import RayPlatform

    platform = RayPlatform(config, run)
    platform.end_left()  # an earlier try died between training and evaluation: they would keep their places
    try:
        with closing(PagePool(config, run, platform, metrics)) as pool:
            yield pool
    finally:
        platform.close()


@dataclass(frozen=True, slots=True)
class Share:
    """The pages `first` to `first + pages - 1` of each task."""

    first: int
    pages: int


@dataclass(slots=True)
class _Work:
    """A share in a process."""

    share: Share
    run: Call  # of the process at that time
    call: Call
    since_s: float


def actor_place(config: Config) -> Place:
    """What a process with a browser asks of its node."""
    actors = config.actors
    resources = {"chrome": actors.chrome} if actors.chrome else {}
    return Place(cpus=actors.cpus, memory_bytes=round(actors.memory_mb * 1e6), resources=resources)


def shares(first: int, pages: int, processes: int) -> list[Share]:
    """Split pages into shares, several for each process."""
    size = -(-pages // min(pages, processes * SHARES_PER_PROCESS))
    return [Share(start, min(size, first + pages - start)) for start in range(first, first + pages, size)]


class PagePool:
    """A player with as many processes as the run has actors. They end with this process."""

    def __init__(self, config: Config, run: str, platform: Platform, metrics: Metrics) -> None:
        """`run` is the identity of the run."""
        place, timeout_s = actor_place(config), config.actors.place_timeout_s

        def member(index: int) -> SupervisedProcess:
            def start() -> Process:
                values = (dump_config(config), run, f"player-{index}")
                return platform.start(PlayerProcess, f"player-{index}", *values, place=place, detached=False)

            return SupervisedProcess(
                f"player-{index}",
                start,
                lambda process, addresses: process.call("run"),
                metrics,
                place_timeout_s=timeout_s,
            )

        self._members = [member(index) for index in range(config.actors.count)]
        self._notice = WaitingNotice(lambda kind: str(place), platform.resources)
        self._pinged_s = time.monotonic()

    def play(
        self,
        spec: AgentSpec,
        purpose: Purpose,
        pages: int,
        *,
        tasks: Sequence[str] = (),
        first: int = 0,
        job: Job | None = None,
    ) -> list[Episode]:
        """See `Player.play`. RuntimeError when no process stays up, or when one share fails each time."""
        waiting, tries = deque(shares(first, pages, len(self._members))), Counter[Share]()
        working: dict[str, _Work] = {}
        episodes: list[Episode] = []
        while waiting or working:
            self._poll()
            for member in self._members:
                work = working.get(member.name)
                if work is not None and (done := self._collect(member, work)) is not None:
                    del working[member.name]
                    if isinstance(done, str):
                        tries[work.share] += 1
                        self._check_tries(tries[work.share], work.share, done)
                        waiting.appendleft(work.share)
                    else:
                        episodes += done
                        if job is not None:
                            job.advance(len(done))
                if waiting and member.name not in working and member.running is not None:
                    share = waiting.popleft()
                    call = member.process.call("play", spec, purpose, share.pages, tasks, share.first)
                    working[member.name] = _Work(share, member.running, call, time.monotonic())
            time.sleep(POLL_S)
        return episodes

    def close(self) -> None:
        """End all processes."""
        for member in self._members:
            member.process.kill()

    def _poll(self) -> None:
        for member in self._members:
            member.poll()
        self._notice.update(self._members)
        if not any(member.healthy for member in self._members):
            raise RuntimeError(f"no process that plays pages stays up: {self._members[0].quarantine_reason}")
        if time.monotonic() - self._pinged_s > PING_S:
            self._pinged_s = time.monotonic()
            for member in self._members:
                member.notify("ping")

    @staticmethod
    def _collect(member: SupervisedProcess, work: _Work) -> list[Episode] | str | None:
        """The episodes of a share, or why there are none; None while it is played."""
        if member.running is not work.run:
            return member.last_error
        if not work.call.done():
            waited_s = time.monotonic() - work.since_s
            if waited_s > SHARE_TIMEOUT_S:
                member.replace(waited_s, heartbeat_received=True)
                return member.last_error
            return None
        try:
            messages: list[bytes] = work.call.result(SHARE_TIMEOUT_S)
        except ProcessDied as error:
            return str(error)
        return [build_episode(*decode(message)) for message in messages]

    @staticmethod
    def _check_tries(tries: int, share: Share, error: str) -> None:
        if tries >= MAX_TRIES:
            last = share.first + share.pages - 1
            raise RuntimeError(f"pages {share.first} to {last} could not be played, tried {tries} times: {error}")
