"""Faults upon faults on real processes, then quiet, then the books: where did every episode go?

python -m tests.chaos.storm FOLDER SETTINGS (JSON) writes FOLDER/ledger.json. The learner's thread that takes is
simulated (tests.chaos.trainer), and so is the actors' playing (tests.chaos.crowd); the rest is the real thing.
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from learner.checkpoint import latest_checkpoint
from learner.stream.admission import DROPPED, TAKEN
from learner.stream.snapshot import IngestSnapshot
from tests.chaos.crowd import INCARNATIONS, SEQUENCES, crowd, finished, read_version
from tests.chaos.relay import relay
from tests.chaos.trainer import SLOW, TRAINED, WRITING, train

CALM_S = 120.0  # for everybody to hand over in the end
HARMS = "harms.json"  # what the last relay did to messages
PROGRESS_S = 60.0  # without a step of the learner, however much it suffers: a hang


def start(name: str, work: Callable[[], None]) -> int:
    """A process of its own, forked from this one; its pid."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        except BaseException as error:  # noqa: BLE001 - the parent must not go on twice
            os.write(2, f"{name}: {error!r}\n".encode())
            os._exit(1)
        os._exit(0)
    return pid


class Storm:
    """Processes, and what happens to them."""

    def __init__(self, folder: Path, *, crowds: int, players: int, batch: int, seed: int) -> None:
        self.folder, self._players, self._batch, self._rng = folder, players, batch, random.Random(seed)
        self._ports = free_ports(2)
        self._pids: dict[str, int] = {}
        self._incarnations = [0] * crowds
        self._zombies: list[int] = []
        self.faults: Counter[str] = Counter()
        self.recoveries: dict[str, list[float]] = {"learner": [], "actors": []}
        self._start_trainer()
        self._pids["relay"] = start("relay", lambda: relay(self._ports[1], self._ports[0], seed, folder / HARMS))
        for place in range(crowds):
            self._start_crowd(place)

    def rage(self, *, faults: int, episodes: int, deadline_s: float) -> None:
        """Until there were so many faults and so many episodes were finished."""
        kinds: list[Callable[[], None]] = [
            self._kill_crowd,
            self._kill_crowd,
            self._leave_crowd,
            self._stop_crowd,
            self._wake_zombie,
            self._kill_trainer,
            self._kill_trainer_writing,
            self._stop_trainer,
            self._slow_trainer,
            self._kill_relay,
            self._cut,
        ]
        begun_s, step, moved_s = time.monotonic(), 0, time.monotonic()
        while sum(self.faults.values()) < faults or sum(finished(self.folder).values()) < episodes:
            assert time.monotonic() - begun_s < deadline_s, f"not through after {deadline_s} s: {self.faults}"
            if sum(self.faults.values()) < faults:
                kind = self._rng.choice(kinds)
                kind()
                self.faults[kind.__name__.strip("_")] += 1
            time.sleep(self._rng.random() * 0.3)
            if read_version(self.folder) != step:
                step, moved_s = read_version(self.folder), time.monotonic()
            assert time.monotonic() - moved_s < PROGRESS_S, f"no step for {PROGRESS_S} s after {self.faults}"

    def calm(self) -> None:
        """Everybody hands over and ends; the learner last."""
        (self.folder / SLOW).write_text("0")
        for name in [*(name for name in self._pids if name.startswith("crowd")), "trainer"]:
            os.kill(self._pids[name], signal.SIGTERM)
            assert self._ended(self._pids.pop(name), CALM_S) == 0, name
        os.kill(self._pids["relay"], signal.SIGTERM)
        assert self._ended(self._pids.pop("relay"), CALM_S) == 0
        for zombie in self._zombies:
            assert self._ended(zombie, CALM_S) == 0, "a replaced actor did not end"

    def close(self) -> None:
        """Nothing is left, whatever went wrong."""
        for pid in [*self._pids.values(), *self._zombies]:
            with suppress(ProcessLookupError, ChildProcessError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)

    def _start_crowd(self, place: int) -> None:
        actors = range(place * self._players, (place + 1) * self._players)
        incarnation = self._incarnations[place]
        self._incarnations[place] += 1
        port = self._ports[place % 2]  # every other one behind the bad network
        name = f"crowd-{place}"
        self._pids[name] = start(name, lambda: crowd(self.folder, f"127.0.0.1:{port}", actors, incarnation))

    def _any_crowd(self) -> int:
        return self._rng.randrange(len(self._incarnations))

    def _kill(self, name: str) -> None:
        pid = self._pids.pop(name)
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)

    def _kill_crowd(self) -> None:
        place = self._any_crowd()
        self._kill(f"crowd-{place}")
        self._start_crowd(place)

    def _leave_crowd(self) -> None:
        """All of them hand over and go, and others come."""
        place = self._any_crowd()
        leaving = self._pids.pop(f"crowd-{place}")
        os.kill(leaving, signal.SIGTERM)
        assert self._ended(leaving, CALM_S) == 0, f"crowd-{place}"
        self._start_crowd(place)

    def _stop_crowd(self) -> None:
        self._pause(f"crowd-{self._any_crowd()}", 0.5)

    def _wake_zombie(self) -> None:
        """One hangs, is replaced, and wakes up while its successor is at work."""
        place = self._any_crowd()
        zombie = self._pids.pop(f"crowd-{place}")
        os.kill(zombie, signal.SIGSTOP)
        self._start_crowd(place)
        time.sleep(0.3)
        os.kill(zombie, signal.SIGCONT)
        self._zombies.append(zombie)

    def _kill_trainer(self) -> None:
        self._kill("trainer")
        self._start_trainer()

    def _kill_trainer_writing(self) -> None:
        until_s = time.monotonic() + 5
        while not (self.folder / WRITING).exists() and time.monotonic() < until_s:
            time.sleep(0.0005)
        time.sleep(self._rng.random() * 0.02)
        self._kill_trainer()

    def _start_trainer(self) -> None:
        before, since_s = read_version(self.folder), time.monotonic()
        self._pids["trainer"] = start("trainer", lambda: train(self.folder, self._ports[0], batch=self._batch))
        changed = (self.folder / "version").stat().st_mtime_ns if before else 0
        while time.monotonic() - since_s < PROGRESS_S:
            if before and (self.folder / "version").stat().st_mtime_ns != changed:
                self.recoveries["learner"].append(round(time.monotonic() - since_s, 3))
                return
            if not before:
                return
            time.sleep(0.005)
        raise AssertionError(f"the learner came back and did not train within {PROGRESS_S} s")

    def _stop_trainer(self) -> None:
        self._pause("trainer", 0.5)

    def _slow_trainer(self) -> None:
        (self.folder / SLOW).write_text(str(self._rng.choice([0, 0, 0.02, 0.1])))

    def _kill_relay(self) -> None:
        self._kill("relay")
        seed = self._rng.randrange(1 << 30)
        self._pids["relay"] = start("relay", lambda: relay(self._ports[1], self._ports[0], seed, self.folder / HARMS))

    def _cut(self) -> None:
        self._pause("relay", 1.0)

    def _pause(self, name: str, longest_s: float) -> None:
        os.kill(self._pids[name], signal.SIGSTOP)
        time.sleep(self._rng.random() * longest_s)
        os.kill(self._pids[name], signal.SIGCONT)

    def _ended(self, pid: int, timeout_s: float) -> int:
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
        raise AssertionError(f"process {pid} runs after {timeout_s} s")


def settle_accounts(folder: Path) -> dict[str, Any]:
    """By the last checkpoint and the actors' own files: how many episodes went where, and how many nowhere."""
    last = latest_checkpoint(folder / "checkpoints")
    held, trained = IngestSnapshot.load(last), np.load(last / TRAINED)
    queue = [episode.trajectory.seed for episode in held.episodes]
    made = finished(folder)
    foreign = [k for k in [*trained.tolist(), *queue] if _place(k)[1] >= made.get(_place(k)[0], 0)]
    counts = {name: held.counts.get(name, 0) for name in DROPPED}
    return {
        "finished": sum(made.values()),
        "incarnations": len(made),
        "trained": len(trained),
        "trained_twice": len(trained) - len(np.unique(trained)) + len(set(queue) & set(trained.tolist())),
        "never_finished": len(foreign),
        "queued": len(queue),
        "dropped": counts,
        "unaccounted": sum(made.values()) - len(trained) - len(queue) - sum(counts.values()),
        "taken_by_the_books": held.counts.get(TAKEN, 0),
    }


def _place(number: int) -> tuple[tuple[int, int], int]:
    which, sequence = divmod(number, SEQUENCES)
    return divmod(which, INCARNATIONS), sequence


def free_ports(count: int) -> list[int]:
    servers = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [server.getsockname()[1] for server in servers]
    for server in servers:
        server.close()
    return ports


def main() -> None:
    folder, settings = Path(sys.argv[1]), json.loads(sys.argv[2])
    since_s = time.monotonic()
    storm = Storm(folder, seed=settings["seed"], **{name: settings[name] for name in ("crowds", "players", "batch")})
    try:
        storm.rage(faults=settings["faults"], episodes=settings["episodes"], deadline_s=settings["deadline_s"])
        storm.calm()
    finally:
        storm.close()
    ledger = settle_accounts(folder)
    ledger |= {"faults": dict(storm.faults), "learner_back_s": storm.recoveries["learner"]}
    ledger["harms"] = json.loads((folder / HARMS).read_text())
    ledger["seconds"] = round(time.monotonic() - since_s, 1)
    (folder / "ledger.json").write_text(json.dumps(ledger, indent=2) + "\n")


if __name__ == "__main__":
    main()
