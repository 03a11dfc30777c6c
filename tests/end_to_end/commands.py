"""Runs the giirl command as a user does, in its own process group, and finds the processes that it leaves behind."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil
from prometheus_client.parser import text_string_to_metric_families

ROOT = Path(__file__).parent.parent.parent
POLL_S = 0.2
CLEANUP_S = 20.0  # after the command has ended, for the processes that it started to end
HTTP_TIMEOUT_S = 5.0  # on loopback
LOOPBACK = urllib.request.build_opener(urllib.request.ProxyHandler({}))

Sample = dict[tuple[str, frozenset[tuple[str, str]]], float]


def short_folder() -> Path:
    """A temporary folder with a short path: Ray and Chrome put sockets there, whose paths must not be long."""
    return Path(tempfile.mkdtemp(prefix="gt-", dir="/tmp"))


@contextmanager
def run_folder() -> Iterator[Path]:
    """The folder of a run that does not exist yet. Its parent folder is deleted when the block ends."""
    folder = short_folder()
    try:
        yield folder / "run"
    finally:
        shutil.rmtree(folder)


def scrape(address: str, timeout_s: float = HTTP_TIMEOUT_S) -> Sample:
    """All samples of a metrics endpoint."""
    with LOOPBACK.open(f"http://{address}/metrics", timeout=timeout_s) as response:
        families = text_string_to_metric_families(response.read().decode())
        return {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}


def total(sample: Sample, name: str, **labels: str) -> float:
    """The sum of a metric over all samples that have these labels; 0 if there are none."""
    return sum(
        value for (metric, all_labels), value in sample.items() if metric == name and labels.items() <= all_labels
    )


class Command:
    """A running `giirl ...` command. Leaving the `with` block kills all processes that are left of it."""

    def __init__(
        self, *arguments: str | Path, env: dict[str, str] | None = None, program: list[str] | None = None
    ) -> None:
        self.arguments = [str(argument) for argument in arguments]
        self.temporary = short_folder()
        self._descendants: set[psutil.Process] = set()
        self._files = [(self.temporary / name).open("wb+") for name in ("stdout", "stderr")]
        self.process = subprocess.Popen(
            [*(program or [sys.executable, "-m", "giirl"]), *self.arguments],
            cwd=ROOT,
            env={**os.environ, "TMPDIR": str(self.temporary), "COLUMNS": "120", **(env or {})},
            stdin=subprocess.DEVNULL,
            stdout=self._files[0],
            stderr=self._files[1],
            start_new_session=True,
        )

    def __enter__(self) -> Command:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        running = [psutil.Process(self.process.pid)] if self.process.poll() is None else []
        for process in [*self.leftover(), *running]:
            kill(process)
        self.process.wait(timeout=CLEANUP_S)
        for process in self.leftover():  # started while the others were killed
            kill(process)
        for file in self._files:
            file.close()
        shutil.rmtree(self.temporary, ignore_errors=True)

    @property
    def out(self) -> str:
        return (self.temporary / "stdout").read_text(errors="replace")

    @property
    def err(self) -> str:
        return (self.temporary / "stderr").read_text(errors="replace")

    @property
    def output(self) -> str:
        return self.out + self.err

    def find_descendants(self) -> list[psutil.Process]:
        """All processes below the command. They are remembered, because an orphan gets another parent."""
        try:
            found: list[psutil.Process] = psutil.Process(self.process.pid).children(recursive=True)
        except psutil.NoSuchProcess:
            found = []
        self._descendants |= set(found)
        return found

    def leftover(self) -> list[psutil.Process]:
        """Running processes that the command started: descendants, or with its temporary folder in the command line."""
        found = [process for process in self._descendants if alive(process)]
        for process in psutil.process_iter():
            if process not in found and str(self.temporary) in " ".join(command_line(process)) and alive(process):
                found.append(process)
        return [process for process in found if process.pid != self.process.pid]

    def until(self, condition: Callable[[], bool], what: str, *, timeout_s: float = 90.0) -> None:
        """Wait until `condition` is true. Raises AssertionError on timeout, or if the command ends first."""
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            self.find_descendants()
            if self.process.poll() is not None:
                raise AssertionError(f"giirl ended with {self.process.returncode} before {what}:\n{self.err}")
            if time.monotonic() > deadline_s:
                raise AssertionError(f"no {what} within {timeout_s} s:\n{self.err}")
            time.sleep(POLL_S)

    def stop(self, number: signal.Signals) -> None:
        """Send SIGINT to the process group, as a terminal does for Ctrl-C; any other signal only to the command."""
        self.find_descendants()
        if number is signal.SIGINT:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)

    def wait(self, *, timeout_s: float = 90.0) -> int:
        """Wait for the end of the command; returns its exit status."""
        deadline_s = time.monotonic() + timeout_s
        while self.process.poll() is None:
            if time.monotonic() > deadline_s:
                raise AssertionError(f"giirl {' '.join(self.arguments)} still runs after {timeout_s} s:\n{self.err}")
            self.find_descendants()
            time.sleep(POLL_S)
        return self.process.returncode

    def wait_leftover(self, *, timeout_s: float = CLEANUP_S) -> list[str]:
        """Wait until no processes are left of the command; returns those that are left on timeout, as text."""
        deadline_s = time.monotonic() + timeout_s
        while (left := self.leftover()) and time.monotonic() < deadline_s:
            time.sleep(POLL_S)
        return [f"{process.pid} {' '.join(command_line(process))[:120]}" for process in left]


def find(command: Command, title: str) -> list[psutil.Process]:
    """The running processes of a Ray actor class, which Ray gives a title such as "ray::ActorProcess"."""
    return [p for p in command.find_descendants() if alive(p) and " ".join(command_line(p)[:1]).startswith(title)]


def run_giirl(
    *arguments: str | Path, env: dict[str, str] | None = None, timeout_s: float = 90.0
) -> tuple[int, str, list[str]]:
    """Run a command to its end; returns exit status, output and the processes that are left."""
    with Command(*arguments, env=env) as command:
        status = command.wait(timeout_s=timeout_s)
        return status, command.output, command.wait_leftover()


def alive(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def command_line(process: psutil.Process) -> list[str]:
    try:
        return list(process.cmdline())
    except (psutil.NoSuchProcess, psutil.AccessDenied, psutil.ZombieProcess):
        return []


def kill(process: psutil.Process) -> None:
    """SIGKILL, so that the process cannot clean up."""
    try:
        process.kill()
    except psutil.NoSuchProcess:
        return


def read_json(path: Path) -> Any:
    return json.loads(path.read_text())


def curve(run: Path) -> list[dict[str, Any]]:
    """The rows of a run's learning curve so far."""
    path = run / "curve.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def step(run: Path) -> int:
    """The last iteration in the learning curve, 0 before the first."""
    rows = curve(run)
    return int(rows[-1]["step"]) if rows else 0


def targets(run: Path) -> dict[str, str]:
    """Process name -> metrics address, from the file that a run writes for Prometheus."""
    path = run / "prometheus.json"
    if not path.exists():
        return {}
    return {group["labels"]["process"]: group["targets"][0] for group in read_json(path)}


def try_scrape(run: Path, process: str) -> Sample:
    """The current metrics of a process of the run; empty while it is down or starting."""
    try:
        return scrape(targets(run).get(process, "127.0.0.1:9"))
    except (urllib.error.URLError, OSError, json.JSONDecodeError):
        return {}
