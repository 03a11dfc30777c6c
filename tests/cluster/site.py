"""A Ray cluster on simulated machines, and one run on it that is started by the same command every time."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from actors.episode_counter import read_counts
from learner.checkpoint import latest_checkpoint
from learner.stream.snapshot import IngestSnapshot
from tests.cluster.machines import Machine, machines
from tests.end_to_end.cluster import PROGRAMS, RAY
from tests.end_to_end.commands import Command, alive, command_line, curve, short_folder, step

PORT = 6379
JOIN_S = 90.0  # for a node to join the cluster
START_S = 200.0  # Ray and torch take long to start on a busy machine
SETTINGS = (
    "runtime=ray",
    "browser=fake",
    f"tasks={json.dumps(['click-test-2'])}",
    "iterations=100000",
    "rollout_batch=8",
    "checkpoint_every=20",
    "net.vectors=hashed",
    "net.width=16",
    "discriminator.batch=8",
    "discriminator.updates=1",
    "policy.sampled_actions=4",
    "demos.per_task=4",
    "evaluate.episodes=4",
    "evaluate.random_episodes=4",
    "actors.count=3",
    "actors.memory_mb=100",
    "actors.step_delay_s=0.05",
    "actors.orphan_timeout_s=120",
    "scoring.replicas=2",
)


class Site:
    """Four machines: `head` and `learner` have no CPUs for actors, `a` and `b` have two each."""

    CPUS: dict[str, int] = {"head": 0, "learner": 0, "a": 2, "b": 2}  # noqa: RUF012

    def __init__(self, found: dict[str, Machine], folder: Path) -> None:
        self.machines, self.run = found, folder / "run"
        self._folder = folder
        self._env = {
            "PATH": f"{PROGRAMS}:{os.environ['PATH']}",
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": secrets.token_hex(32),
            "RAY_ADDRESS": "",
            "RAY_worker_niceness": "0",
        }
        self._cut: set[str] = set()  # machines that lost their power in a run
        self._nodes: dict[str, Command] = {}  # `ray start` of each machine that is on

    def power_on(self, name: str) -> None:
        """Turn a machine on and let it join the cluster; the head has to be the first."""
        machine = self.machines[name]
        machine.power_on()
        where = ["--head", f"--port={PORT}", "--include-dashboard=false"]
        if name != "head":
            where = [f"--address={self.machines['head'].address}:{PORT}"]
        words = [
            *("start", "--block", "--disable-usage-stats", f"--node-ip-address={machine.address}", *where),
            *(f"--num-cpus={self.CPUS[name]}", f"--object-store-memory={128 << 20}"),
        ]
        node = machine.command(*words, program=[RAY], env=self._env)
        self._nodes[name] = node.__enter__()
        node.until(lambda: "Ray runtime started" in node.output, f"Ray on {name}", timeout_s=JOIN_S)

    def power_cut(self, name: str) -> None:
        """Cut the power of a machine."""
        self._cut.add(name)
        self.machines[name].power_cut()
        self._nodes.pop(name).__exit__(None, None, None)

    def train(self, *changes: str, machine: str = "learner") -> Command:
        """The command of the run, the same for every try."""
        words = ("train", *SETTINGS, f"run={self.run}", *changes, "--resume-or-start")
        program = [str(PROGRAMS / "python"), "-m", "giirl"]
        return self.machines[machine].command(*words, program=program, env=self._env)

    def close(self) -> None:
        for name in list(self._nodes):
            self.power_cut(name)

    def until_step(self, command: Command, wanted: int) -> None:
        command.until(lambda: step(self.run) >= wanted, f"iteration {wanted}", timeout_s=START_S)

    def goes_on(self, command: Command, steps: int = 20) -> float:
        """Wait for so many further iterations; returns the longest time without one, in seconds."""
        first = step(self.run)
        since_s = last_s = time.monotonic()
        longest_s, seen = 0.0, first
        while seen < first + steps:
            assert command.process.poll() is None, command.err
            assert last_s - since_s < START_S, command.err
            time.sleep(0.05)
            now_s = time.monotonic()
            longest_s = max(longest_s, now_s - last_s)
            if (reached := step(self.run)) != seen:
                seen, last_s = reached, now_s
            assert now_s - last_s < START_S, command.err
        return longest_s

    def stop(self, command: Command) -> int:
        """End the run as a job is stopped; returns how many episodes are then unaccounted for.

        Those are episodes that an actor has counted, and that the checkpoint neither trained on, nor queued, nor
        dropped. The actors delete their counts at the end, so the files are linked before.
        """
        identity, links = (self.run / "identity").read_text(), short_folder()
        for name, machine in self.machines.items():
            for path in machine.temporary.glob(f"giirl-*/{identity}/actor-*.count"):
                (links / f"{path.stem}@{name}").hardlink_to(path)
        send(command, signal.SIGTERM)
        assert command.wait() == 130, command.err
        assert "stopped and saved" in command.err
        left = {n for n, machine in self.machines.items() for _ in machine.temporary.glob(f"giirl-*/{identity}/*")}
        assert left <= self._cut  # actors that a power cut ended cannot delete their counts
        snapshot = IngestSnapshot.load(latest_checkpoint(self.run / "checkpoints"))
        assert snapshot.counts["taken"] == curve(self.run)[-1]["episodes"]
        missing = counted = 0
        for offsets in snapshot.offsets:
            for link in links.glob(f"{offsets.actor}@*"):
                finished = dict(read_counts(link)).get(offsets.incarnation, 0)
                counted += finished
                missing += max(0, finished - offsets.low_watermark - len(offsets.acked))
        assert counted
        shutil.rmtree(links)
        return missing

    def actors(self) -> set[str]:
        """The actors whose episodes the newest checkpoint knows."""
        snapshot = IngestSnapshot.load(latest_checkpoint(self.run / "checkpoints"))
        return {offsets.actor for offsets in snapshot.offsets if offsets.low_watermark}


def send(command: Command, number: signal.Signals) -> None:
    """Send a signal to a command on a machine: to the process inside, which has no parent there."""
    inside = [process for process in command.find_descendants() if alive(process)]
    giirl = next(process for process in inside if "giirl" in command_line(process))
    giirl.send_signal(number)


@contextmanager
def site() -> Iterator[Site]:
    """The machines without power, and a folder that they share."""
    folder = short_folder()
    try:
        with machines(*Site.CPUS) as found:
            opened = Site(found, folder)
            try:
                yield opened
            finally:
                opened.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
