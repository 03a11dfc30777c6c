"""Many simulated actors in one process: they do not play, but deliver made-up episodes as real actors do.

Each has a real uplink, episode counter and socket.
"""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from actors.episode_counter import ENTRY, EpisodeCounter, Replaced, read_counts
from actors.uplink import Refused, Uplink, UplinkLimits
from giirl_core.types import Action, Episode, Goal, Outcome, Page, Trajectory, Verb
from giirl_core.wire.transport import Keys

INCARNATIONS = 1 << 12
SEQUENCES = 1 << 24
ROUND_S = 0.05  # pause between two rounds through all actors
VERSION_POLL_S = 0.05  # between two reads of the learner's version
VERSION_FILE = "version"
LIMITS = UplinkLimits(max_kept_bytes=256 << 10, heartbeat_s=0.2, hello_s=0.1)


def episode_id(actor: int, incarnation: int, sequence: int) -> int:
    """A number for each episode of the test; it is used as the page seed."""
    return (actor * INCARNATIONS + incarnation) * SEQUENCES + sequence


class LoggedCounter(EpisodeCounter):
    """Writes the counts that it forgets to a file, from which the test computes its ledger."""

    def __init__(self, path: Path, incarnation: int) -> None:
        self._log = path.with_suffix(".settled")
        super().__init__(path, incarnation)

    def forget_before(self, incarnation: int) -> None:
        forgotten = [entry for entry in self.before if entry[0] < incarnation]
        if forgotten:
            with self._log.open("ab") as file:
                file.write(b"".join(ENTRY.pack(*entry) for entry in forgotten))
        super().forget_before(incarnation)


def finished_counts(folder: Path) -> dict[tuple[int, int], int]:
    """(actor, incarnation) -> episodes it finished, from the actors' own files."""
    counts: dict[tuple[int, int], int] = {}
    for suffix in ("settled", "count"):
        for path in sorted(folder.glob(f"actor-*.{suffix}")):
            actor = int(path.stem.rpartition("-")[2])
            for incarnation, count in read_counts(path):
                counts[actor, incarnation] = max(count, counts.get((actor, incarnation), 0))
    return counts


def make_episode(size: int) -> Episode:
    """An episode of about `size` bytes on the wire."""
    rows = max(1, size // 60)
    page = Page(
        tag=("button",) * rows,
        text=("Ok",) * rows,
        value=("",) * rows,
        classes=("",) * rows,
        ref=np.arange(rows, dtype=np.int32),
        parent=np.full(rows, -1, dtype=np.int16),
        box=np.zeros((rows, 4), dtype=np.float32),
        focused=np.zeros(rows, dtype=np.bool_),
        tampered=np.zeros(rows, dtype=np.bool_),
    )
    trajectory = Trajectory(
        task="click-test",
        goal=Goal("Click the button."),
        seed=0,
        pages=(page,),
        actions=(Action(verb=Verb.CLICK, element=0),),
        behaviour_logp=np.zeros(1, dtype=np.float32),
        rewards=np.zeros(1, dtype=np.float32),
        policy_version=0,
    )
    return Episode(trajectory=trajectory, outcome=Outcome(raw_reward=1.0, ended=True))


class SimulatedActor:
    """One simulated actor."""

    def __init__(self, folder: Path, address: str, actor: int, incarnation: int, keys: Keys | None) -> None:
        self.actor, self.incarnation, self.sequence = actor, incarnation, 0
        name = f"actor-{actor}"
        self.counter = LoggedCounter(folder / f"{name}.count", incarnation)
        self.uplink = Uplink(
            address, run="chaos", actor=name, incarnation=incarnation, counter=self.counter, limits=LIMITS, keys=keys
        )

    def finish_episode(self, template: Episode, version: int) -> None:
        seed = episode_id(self.actor, self.incarnation, self.sequence)
        trajectory = replace(template.trajectory, seed=seed, policy_version=version)
        assert self.uplink.submit(replace(template, trajectory=trajectory)) == self.sequence
        self.sequence += 1


def run_actors(
    folder: Path,
    address: str,
    actors: Sequence[int],
    incarnation: int,
    *,
    size: int = 600,
    keys: Keys | None = None,
) -> None:
    """Finish episodes until SIGTERM, then deliver the rest, wait for a checkpoint that covers them, and say goodbye."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda signum, frame: stopped.append(signum))
    template, rng = make_episode(size), random.Random(actors[0])
    running = []
    for number in actors:
        with suppress(Replaced):
            running.append(SimulatedActor(folder, address, number, incarnation, keys))
    version, read_s = 0, 0.0
    while running and not stopped:
        if time.monotonic() - read_s > VERSION_POLL_S:
            version, read_s = read_version(folder), time.monotonic()
        for actor in list(running):
            try:
                actor.uplink.poll()
                if actor.uplink.startable(0) and rng.random() < 0.5:
                    actor.finish_episode(template, version)
            except Refused:
                running.remove(actor)
        time.sleep(ROUND_S)
    deliver_all(running)


def deliver_all(running: list[SimulatedActor], timeout_s: float = 60.0) -> None:
    """Poll all actors in turn: one that waits for its checkpoint must not keep the others from sending."""
    deadline_s = time.monotonic() + timeout_s
    while running and time.monotonic() < deadline_s:
        for actor in list(running):
            try:
                if actor.uplink.wait_committed(0.0):
                    actor.uplink.close()
                    running.remove(actor)
                else:
                    actor.uplink.poll()
            except Refused:
                running.remove(actor)
        time.sleep(0.002)
    for actor in running:  # their remaining episodes are lost; the goodbye reports them
        actor.uplink.close()


def read_version(folder: Path) -> int:
    path = folder / VERSION_FILE
    return int(path.read_text()) if path.exists() else 0
