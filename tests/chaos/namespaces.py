"""Two network namespaces with a cable between them that can be cut. Needs root and iproute2."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CLONE_NEWNET = 0x40000000
HOSTS = {"learner": "10.117.0.1", "actors": "10.117.0.2"}


def missing() -> str:
    """Why there can be no namespaces here, "" when there can."""
    if shutil.which("ip") is None:
        return "there is no program ip: apt-get install iproute2"
    name = f"giirl-try-{os.getpid()}"
    tried = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if tried.returncode:
        return f"no network namespaces: {tried.stderr.strip()}"
    _ip("netns", "delete", name)
    return ""


class Cable:
    """Between the namespaces of this process's learner and actors."""

    def __init__(self) -> None:
        self._names = {side: f"giirl-{side}-{os.getpid()}" for side in HOSTS}

    def enter(self, side: str) -> None:
        """This process, and what it starts, is at that end from now on."""
        with Path(f"/run/netns/{self._names[side]}").open() as file:
            if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")

    def cut(self) -> None:
        _ip("-n", self._names["learner"], "link", "set", "cable", "down")

    def mend(self) -> None:
        _ip("-n", self._names["learner"], "link", "set", "cable", "up")

    def lay(self) -> None:
        for name in self._names.values():
            _ip("netns", "add", name)
        ends = [(self._names[side], host) for side, host in HOSTS.items()]
        _ip("-n", ends[0][0], "link", "add", "cable", "type", "veth", "peer", "name", "cable", "netns", ends[1][0])
        for name, host in ends:
            _ip("-n", name, "addr", "add", f"{host}/24", "dev", "cable")
            _ip("-n", name, "link", "set", "cable", "up")

    def remove(self) -> None:
        for name in self._names.values():
            subprocess.run(["ip", "netns", "delete", name], capture_output=True, check=False)


@contextmanager
def cable() -> Iterator[Cable]:
    made = Cable()
    try:
        made.lay()
        yield made
    finally:
        made.remove()


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)
