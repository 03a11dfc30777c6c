"""The owner's side of one chromedriver: its port, what it and Chrome write, and the end of both."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path

from browser_farm.chrome import reaper
from browser_farm.chrome.launch_errors import find_cause

PORT = re.compile(r"started successfully on port (\d+)")
KEPT_BYTES = 16 << 10  # of the output; the pages of a long run may write any amount


class Driver:
    """A chromedriver under a `reaper`, which ends at once when it starts a Chrome that cannot be used."""

    def __init__(self, program: Path, directory: Path, environment: Mapping[str, str]) -> None:
        """Start `program` with these variables in addition to its owner's; OSError if there are no resources for it."""
        self._owner, self._directory = os.getpid(), directory
        command = [sys.executable, "-I", "-S", reaper.__file__, str(directory), str(self._owner)]
        self._process = subprocess.Popen(
            [*command, str(program), "--port=0", "--enable-chrome-logs"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,  # a buffer has a lock, which a fork of this process could inherit locked
            start_new_session=True,  # Ctrl-C in the terminal reaches the owner only
            cwd="/",
            env={**os.environ, **environment},
        )
        self._output = b""
        self._launching = True
        self._settled = threading.Event()  # the port is known, or the output has ended
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def output(self) -> str:
        """The last of what chromedriver and Chrome have written."""
        return self._output.decode(errors="replace")

    def wait_for_port(self, timeout_s: float) -> int | None:
        """The port on 127.0.0.1 that chromedriver listens on; None if it ended or named none in time."""
        self._settled.wait(timeout_s)
        port = PORT.search(self.output)
        return int(port.group(1)) if port else None

    def launched(self) -> None:
        """Chrome is up: what is written from now on may come from its pages."""
        self._launching = False

    def stop(self) -> None:
        """Let the reaper kill chromedriver and Chrome, without waiting."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # it has ended already
            self._process.stdin.write(b"\n")

    def end(self) -> None:
        """Kill chromedriver and Chrome, wait until they are gone, and remove their directory.

        Does nothing in a fork of the owner: they are the owner's.
        """
        if os.getpid() != self._owner:
            return
        self.stop()
        try:
            self._process.wait(timeout=2 * reaper.TIMEOUT_S)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        reaper.reap(self._directory)  # the reaper itself may have been killed
        self._reader.join(timeout=reaper.TIMEOUT_S)
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()

    def _read(self) -> None:
        assert self._process.stdout is not None
        pipe = self._process.stdout.fileno()
        while chunk := os.read(pipe, KEPT_BYTES):
            self._output = (self._output + chunk)[-KEPT_BYTES:]
            if self._launching:
                cause = find_cause(self.output)
                if cause is not None and cause.hangs:
                    self.stop()
                if PORT.search(self.output):
                    self._settled.set()
        self._settled.set()
