"""Injects many faults into real processes, then shuts them down and computes a ledger: where did every episode go?

python -m tests.chaos.storm FOLDER SETTINGS (JSON) writes FOLDER/ledger.json. Training is simulated
(tests.chaos.trainer), and so is playing (tests.chaos.crowd); everything else is real. A crowd is a process with
several actors.
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

from giirl_core.telemetry.series import DROPPED
from learner.checkpoint import latest_checkpoint
from learner.stream.admission import LOST, TAKEN
from learner.stream.snapshot import IngestSnapshot
from tests.chaos import raw_peer
from tests.chaos.crowd import INCARNATIONS, SEQUENCES, VERSION_FILE, finished_counts, read_version, run_actors
from tests.chaos.relay import relay
from tests.chaos.trainer import TRAINED_FILE, UPDATE_S_FILE, WRITING_FILE, train

SHUTDOWN_S = 120.0  # for a process to deliver its episodes and end
RELAY_FAULTS_FILE = "relay_faults.json"  # the number of faults of each kind that the last relay injected
STRANGE_MESSAGES = 2_000  # from a peer that is no actor
PROGRESS_S = 60.0  # without a step of the learner, in spite of all faults, counts as a hang


def start(name: str, work: Callable[[], None]) -> int:
    """Run `work` in a forked process; returns its pid."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        except BaseException as error:  # noqa: BLE001 - the child must not run the code of the parent
            os.write(2, f"{name}: {error!r}\n".encode())
            os._exit(1)
        os._exit(0)
    return pid


class Storm:
    """The processes of one test, and the faults that are injected into them."""

    def __init__(self, folder: Path, *, crowds: int, actors_per_crowd: int, batch: int, seed: int) -> None:
        self.folder, self._actors_per_crowd, self._batch = folder, actors_per_crowd, batch
        self._rng = random.Random(seed)
        self._ports = free_ports(2)
        self._pids: dict[str, int] = {}
        self._incarnations = [0] * crowds
        self._zombies: list[int] = []
        self.faults: Counter[str] = Counter()
        self.recoveries_s: list[float] = []  # from each restart of the learner to its next step
        self._start_trainer()
        self._start_relay(seed)
        for index in range(crowds):
            self._start_crowd(index)

    def inject_faults(self, *, faults: int, episodes: int, deadline_s: float) -> None:
        """Inject random faults until there were `faults` of them and the actors have finished `episodes`."""
        kinds: list[Callable[[], None]] = [
            self._kill_crowd,
            self._kill_crowd,
            self._replace_crowd,
            self._suspend_crowd,
            self._wake_zombie,
            self._kill_trainer,
            self._kill_trainer_writing,
            self._suspend_trainer,
            self._slow_trainer,
            self._kill_relay,
            self._suspend_relay,
            self._misbehave,
        ]
        started_s, step, progress_s = time.monotonic(), 0, time.monotonic()
        while sum(self.faults.values()) < faults or sum(finished_counts(self.folder).values()) < episodes:
            assert time.monotonic() - started_s < deadline_s, f"not finished after {deadline_s} s: {self.faults}"
            if sum(self.faults.values()) < faults:
                fault = self._rng.choice(kinds)
                fault()
                self.faults[fault.__name__.strip("_")] += 1
            time.sleep(self._rng.random() * 0.3)
            if read_version(self.folder) != step:
                step, progress_s = read_version(self.folder), time.monotonic()
            assert time.monotonic() - progress_s < PROGRESS_S, f"no step for {PROGRESS_S} s after {self.faults}"

    def shut_down(self) -> None:
        """Let the actors deliver their episodes and end, then the learner."""
        (self.folder / UPDATE_S_FILE).write_text("0")
        for name in [*(name for name in self._pids if name.startswith("crowd")), "trainer"]:
            os.kill(self._pids[name], signal.SIGTERM)
            assert self._wait_ended(self._pids.pop(name), SHUTDOWN_S) == 0, name
        os.kill(self._pids["relay"], signal.SIGTERM)
        assert self._wait_ended(self._pids.pop("relay"), SHUTDOWN_S) == 0
        for zombie in self._zombies:
            assert self._wait_ended(zombie, SHUTDOWN_S) == 0, "a replaced actor did not end"

    def close(self) -> None:
        """Kill all processes that are left."""
        for pid in [*self._pids.values(), *self._zombies]:
            with suppress(ProcessLookupError, ChildProcessError):
                os.kill(pid, signal.SIGKILL)
                os.waitpid(pid, 0)

    def _start_relay(self, seed: int) -> None:
        front, back, faults_file = self._ports[1], self._ports[0], self.folder / RELAY_FAULTS_FILE
        self._pids["relay"] = start("relay", lambda: relay(front, back, seed, faults_file))

    def _start_crowd(self, index: int) -> None:
        actors = range(index * self._actors_per_crowd, (index + 1) * self._actors_per_crowd)
        incarnation = self._incarnations[index]
        self._incarnations[index] += 1
        port = self._ports[index % 2]  # every other one is behind the relay
        name = f"crowd-{index}"
        self._pids[name] = start(name, lambda: run_actors(self.folder, f"127.0.0.1:{port}", actors, incarnation))

    def _any_crowd(self) -> int:
        return self._rng.randrange(len(self._incarnations))

    def _kill(self, name: str) -> None:
        pid = self._pids.pop(name)
        os.kill(pid, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        assert status == -signal.SIGKILL, f"{name} had ended with {status} before it was killed"

    def _kill_crowd(self) -> None:
        index = self._any_crowd()
        self._kill(f"crowd-{index}")
        self._start_crowd(index)

    def _replace_crowd(self) -> None:
        """Let the actors deliver their episodes and leave, then start others."""
        index = self._any_crowd()
        leaving = self._pids.pop(f"crowd-{index}")
        os.kill(leaving, signal.SIGTERM)
        assert self._wait_ended(leaving, SHUTDOWN_S) == 0, f"crowd-{index}"
        self._start_crowd(index)

    def _suspend_crowd(self) -> None:
        self._suspend(f"crowd-{self._any_crowd()}", 0.5)

    def _wake_zombie(self) -> None:
        """A crowd hangs, is replaced, and wakes up while its successor is running."""
        index = self._any_crowd()
        zombie = self._pids.pop(f"crowd-{index}")
        os.kill(zombie, signal.SIGSTOP)
        self._start_crowd(index)
        time.sleep(0.3)
        os.kill(zombie, signal.SIGCONT)
        self._zombies.append(zombie)

    def _kill_trainer(self) -> None:
        self._kill("trainer")
        self._start_trainer()

    def _kill_trainer_writing(self) -> None:
        deadline_s = time.monotonic() + 5
        while not (self.folder / WRITING_FILE).exists() and time.monotonic() < deadline_s:
            time.sleep(0.0005)
        time.sleep(self._rng.random() * 0.02)
        self._kill_trainer()

    def _start_trainer(self) -> None:
        before, started_s = read_version(self.folder), time.monotonic()
        self._pids["trainer"] = start("trainer", lambda: train(self.folder, self._ports[0], batch=self._batch))
        changed = (self.folder / VERSION_FILE).stat().st_mtime_ns if before else 0
        while time.monotonic() - started_s < PROGRESS_S:
            if before and (self.folder / VERSION_FILE).stat().st_mtime_ns != changed:
                self.recoveries_s.append(round(time.monotonic() - started_s, 3))
                return
            if not before:
                return
            time.sleep(0.005)
        raise AssertionError(f"the restarted learner made no step within {PROGRESS_S} s")

    def _suspend_trainer(self) -> None:
        self._suspend("trainer", 0.5)

    def _slow_trainer(self) -> None:
        (self.folder / UPDATE_S_FILE).write_text(str(self._rng.choice([0, 0, 0.02, 0.1])))

    def _kill_relay(self) -> None:
        self._kill("relay")
        self._start_relay(self._rng.randrange(1 << 30))

    def _suspend_relay(self) -> None:
        self._suspend("relay", 1.0)

    def _misbehave(self) -> None:
        """A stranger sends more than the suspended learner reads, then disconnects in the middle of a frame."""
        try:
            peer = raw_peer.connect(f"127.0.0.1:{self._ports[0]}")
        except OSError:
            return  # the learner is still starting
        os.kill(self._pids["trainer"], signal.SIGSTOP)
        peer.sendall((raw_peer.MESSAGE + raw_peer.PING) * STRANGE_MESSAGES + raw_peer.OVERSIZED[:5])
        raw_peer.reset(peer)
        time.sleep(self._rng.random() * 0.5)
        os.kill(self._pids["trainer"], signal.SIGCONT)

    def _suspend(self, name: str, longest_s: float) -> None:
        os.kill(self._pids[name], signal.SIGSTOP)
        time.sleep(self._rng.random() * longest_s)
        os.kill(self._pids[name], signal.SIGCONT)

    def _wait_ended(self, pid: int, timeout_s: float) -> int:
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            done, status = os.waitpid(pid, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.02)
        raise AssertionError(f"process {pid} runs after {timeout_s} s")


def compute_ledger(folder: Path) -> dict[str, Any]:
    """Episode counts from the latest checkpoint and the actors' own files; "unaccounted" has to be 0."""
    latest = latest_checkpoint(folder / "checkpoints")
    snapshot, trained = IngestSnapshot.load(latest), np.load(latest / TRAINED_FILE)
    queue = [episode.trajectory.seed for episode in snapshot.episodes]
    finished = finished_counts(folder)
    unknown = [n for n in [*trained.tolist(), *queue] if _split_id(n)[1] >= finished.get(_split_id(n)[0], 0)]
    dropped = {reason: snapshot.counts.get(reason, 0) for reason in (*DROPPED, LOST)}
    return {
        "finished": sum(finished.values()),
        "incarnations": len(finished),
        "trained": len(trained),
        "trained_twice": len(trained) - len(np.unique(trained)) + len(set(queue) & set(trained.tolist())),
        "never_finished": len(unknown),
        "queued": len(queue),
        "dropped": dropped,
        "unaccounted": sum(finished.values()) - len(trained) - len(queue) - sum(dropped.values()),
        "counted_as_taken": snapshot.counts.get(TAKEN, 0),
    }


def _split_id(number: int) -> tuple[tuple[int, int], int]:
    """((actor, incarnation), sequence number) of an episode id."""
    rest, sequence = divmod(number, SEQUENCES)
    return divmod(rest, INCARNATIONS), sequence


def free_ports(count: int) -> list[int]:
    servers = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [server.getsockname()[1] for server in servers]
    for server in servers:
        server.close()
    return ports


def main() -> None:
    folder, settings = Path(sys.argv[1]), json.loads(sys.argv[2])
    started_s = time.monotonic()
    sizes = {name: settings[name] for name in ("crowds", "actors_per_crowd", "batch")}
    storm = Storm(folder, seed=settings["seed"], **sizes)
    try:
        storm.inject_faults(faults=settings["faults"], episodes=settings["episodes"], deadline_s=settings["deadline_s"])
        storm.shut_down()
    finally:
        storm.close()
    ledger = compute_ledger(folder)
    ledger |= {"faults": dict(storm.faults), "learner_back_s": storm.recoveries_s}
    ledger["relay_faults"] = json.loads((folder / RELAY_FAULTS_FILE).read_text())
    ledger["seconds"] = round(time.monotonic() - started_s, 1)
    (folder / "ledger.json").write_text(json.dumps(ledger, indent=2) + "\n")


if __name__ == "__main__":
    main()
