"""Many simulated actors in one process: they play nothing, but hand over episodes as real ones do.

What is simulated is the playing. Uplinks, tallies, sockets and messages are the real ones, one of each an actor.
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
LOOP_S = 0.05  # between two rounds through all actors
LOOK_S = 0.05  # between two looks at the version of the learner
VERSION = "version"
LIMITS = UplinkLimits(pause_at=4, max_kept_bytes=256 << 10, beat_s=0.2, hello_s=0.1)


def key(actor: int, incarnation: int, sequence: int) -> int:
    """One episode among all: what its page's seed says."""
    return (actor * INCARNATIONS + incarnation) * SEQUENCES + sequence


class Remembered(EpisodeCounter):
    """Writes down for the test's own ledger what it forgets because it is settled."""

    def __init__(self, path: Path, incarnation: int) -> None:
        self._log = path.with_suffix(".settled")
        super().__init__(path, incarnation)

    def settle(self, incarnation: int) -> None:
        gone = [entry for entry in self.before if entry[0] < incarnation]
        if gone:
            with self._log.open("ab") as file:
                file.write(b"".join(ENTRY.pack(*entry) for entry in gone))
        super().settle(incarnation)


def finished(folder: Path) -> dict[tuple[int, int], int]:
    """(actor, incarnation) -> episodes it finished, by the actors' own files."""
    found: dict[tuple[int, int], int] = {}
    for suffix in ("settled", "tally"):
        for path in sorted(folder.glob(f"actor-*.{suffix}")):
            actor = int(path.stem.rpartition("-")[2])
            for incarnation, count in read_counts(path):
                found[actor, incarnation] = max(count, found.get((actor, incarnation), 0))
    return found


def template(size: int) -> Episode:
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


class Player:
    """One simulated actor."""

    def __init__(self, folder: Path, address: str, actor: int, incarnation: int, keys: Keys | None) -> None:
        self.actor, self.incarnation, self.sequence = actor, incarnation, 0
        name = f"actor-{actor}"
        self.tally = Remembered(folder / f"{name}.tally", incarnation)
        self.line = Uplink(
            address, run="chaos", actor=name, incarnation=incarnation, tally=self.tally, limits=LIMITS, keys=keys
        )

    def play(self, model: Episode, version: int) -> None:
        seed = key(self.actor, self.incarnation, self.sequence)
        trajectory = replace(model.trajectory, seed=seed, policy_version=version)
        assert self.line.offer(replace(model, trajectory=trajectory)) == self.sequence
        self.sequence += 1


def crowd(
    folder: Path,
    address: str,
    actors: Sequence[int],
    incarnation: int,
    *,
    size: int = 600,
    keys: Keys | None = None,
) -> None:
    """Play until SIGTERM, then hand over, wait for the checkpoint that covers it, and say good-bye."""
    stopped: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, frame: stopped.append(number))
    model, rng = template(size), random.Random(actors[0])
    players = []
    for actor in actors:
        with suppress(Replaced):
            players.append(Player(folder, address, actor, incarnation, keys))
    version, looked_s = 0, 0.0
    while players and not stopped:
        if time.monotonic() - looked_s > LOOK_S:
            version, looked_s = read_version(folder), time.monotonic()
        for player in list(players):
            try:
                player.line.poll()
                if player.line.ready and rng.random() < 0.5:
                    player.play(model, version)
            except Refused:
                players.remove(player)
        time.sleep(LOOP_S)
    hand_over(players)


def hand_over(players: list[Player], timeout_s: float = 60.0) -> None:
    """All at once: one that waits for its checkpoint must not keep the others from sending."""
    deadline_s = time.monotonic() + timeout_s
    while players and time.monotonic() < deadline_s:
        for player in list(players):
            try:
                if player.line.settle(0.0):
                    player.line.close()
                    players.remove(player)
                else:
                    player.line.poll()
            except Refused:
                players.remove(player)
        time.sleep(0.002)
    for player in players:  # what these have left is lost, and they say so
        player.line.close()


def read_version(folder: Path) -> int:
    path = folder / VERSION
    return int(path.read_text()) if path.exists() else 0
