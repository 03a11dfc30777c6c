"""Simulated machines: each has network, process and mount namespaces of its own, and can lose its power.

They share the disk, as a cluster shares a folder for runs, but not `/dev/shm`, `/tmp/ray` and TMPDIR. Needs root, `ip`,
`unshare` and `nsenter`.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.end_to_end.commands import Command, short_folder

SUBNET = "10.118.0"
START_S = 10.0  # for the first process of a machine
PREPARE = "mount -t tmpfs none /dev/shm && mount -t tmpfs none /tmp/ray && echo ready && exec sleep infinity"


def missing() -> str:
    """Why machines cannot be simulated here; "" if they can."""
    for program in ("ip", "unshare", "nsenter"):
        if shutil.which(program) is None:
            return f"the program {program} is missing: apt-get install iproute2 util-linux"
    tried = subprocess.run(
        ["unshare", "--net", "--pid", "--fork", "--mount", "true"], capture_output=True, text=True, check=False
    )
    return f"cannot create namespaces: {tried.stderr.strip()}" if tried.returncode else ""


class Machine:
    """One machine. Leaving the block of `machines` cuts its power."""

    def __init__(self, name: str, number: int, bridge: str) -> None:
        self.name, self.address, self._bridge = name, f"{SUBNET}.{number}", bridge
        self._namespace, self._cable = f"{bridge}-{name}", f"{bridge}{number}"
        self.temporary = short_folder()
        self._first: subprocess.Popen[str] | None = None  # process 1 of the machine
        _ip("netns", "add", self._namespace)
        _ip("link", "add", self._cable, "type", "veth", "peer", "name", "eth0", "netns", self._namespace)
        _ip("link", "set", self._cable, "master", bridge)
        _ip("-n", self._namespace, "addr", "add", f"{self.address}/24", "dev", "eth0")
        for device in ("lo", "eth0"):
            _ip("-n", self._namespace, "link", "set", device, "up")
        _ip("-n", self._namespace, "route", "add", "default", "dev", "eth0")  # programs look for their address that way

    def power_on(self) -> None:
        """Start the machine, with nothing on it."""
        Path("/tmp/ray").mkdir(exist_ok=True)
        words = ["unshare", "--pid", "--fork", "--mount-proc", "--kill-child", "sh", "-c", PREPARE]
        self._first = subprocess.Popen(
            ["ip", "netns", "exec", self._namespace, *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        assert self._first.stdout is not None
        assert self._first.stdout.readline() == "ready\n"
        _ip("link", "set", self._cable, "up")

    def power_cut(self) -> None:
        """Cut the cable, so that nobody hears of it, and kill every process at once."""
        _ip("link", "set", self._cable, "down")
        if self._first is not None:
            os.kill(self._inside, signal.SIGKILL)
            self._first.communicate(timeout=START_S)
            self._first = None

    def unplug(self) -> None:
        """Cut the cable; the processes go on."""
        _ip("link", "set", self._cable, "down")

    def plug(self) -> None:
        _ip("link", "set", self._cable, "up")

    def command(self, *words: str | Path, program: list[str], env: dict[str, str]) -> Command:
        """A command on this machine."""
        enter = ["nsenter", f"--target={self._inside}", "--net", "--pid", "--mount", f"--wdns={Path.cwd()}"]
        return Command(*words, program=[*enter, *program], env={**env, "TMPDIR": str(self.temporary)})

    def remove(self) -> None:
        self.power_cut()
        subprocess.run(["ip", "netns", "delete", self._namespace], capture_output=True, check=False)
        subprocess.run(["ip", "link", "delete", self._cable], capture_output=True, check=False)
        shutil.rmtree(self.temporary, ignore_errors=True)

    @property
    def _inside(self) -> int:
        """The number that the first process of the machine has outside."""
        assert self._first is not None
        deadline_s = time.monotonic() + START_S
        while time.monotonic() < deadline_s:
            children = Path(f"/proc/{self._first.pid}/task/{self._first.pid}/children").read_text().split()
            if children:
                return int(children[0])
            time.sleep(0.01)
        raise AssertionError(f"machine {self.name} has no first process")


@contextmanager
def machines(*names: str) -> Iterator[dict[str, Machine]]:
    """Machines on one network, all but the first of them without power."""
    bridge = f"gm{os.getpid() % 10_000}"
    _ip("link", "add", bridge, "type", "bridge")
    with ExitStack() as stack:
        stack.callback(lambda: subprocess.run(["ip", "link", "delete", bridge], capture_output=True, check=False))
        _ip("link", "set", bridge, "up")
        found = {}
        for number, name in enumerate(names, start=1):
            found[name] = Machine(name, number, bridge)
            stack.callback(found[name].remove)
        yield found


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], check=False, capture_output=True, text=True)
    assert done.returncode == 0, (arguments, done.stderr)
