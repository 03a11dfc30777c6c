"""Two network namespaces with a link between them that can be cut. Needs root and iproute2."""

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
    """Why network namespaces are not available here; "" if they are."""
    if shutil.which("ip") is None:
        return "the program ip is missing: apt-get install iproute2"
    name = f"giirl-try-{os.getpid()}"
    result = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if result.returncode:
        return f"cannot create network namespaces: {result.stderr.strip()}"
    _ip("netns", "delete", name)
    return ""


class Link:
    """A link between the namespaces of the learner and of the actors."""

    def __init__(self) -> None:
        self._names = {side: f"giirl-{side}-{os.getpid()}" for side in HOSTS}

    def enter(self, side: str) -> None:
        """Move this process, and the processes that it will start, into the namespace of this side."""
        with Path(f"/run/netns/{self._names[side]}").open() as file:
            if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "setns")

    def cut(self) -> None:
        _ip("-n", self._names["learner"], "link", "set", "cable", "down")

    def restore(self) -> None:
        _ip("-n", self._names["learner"], "link", "set", "cable", "up")

    def create(self) -> None:
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
def open_link() -> Iterator[Link]:
    link = Link()
    try:
        link.create()
        yield link
    finally:
        link.remove()


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)
