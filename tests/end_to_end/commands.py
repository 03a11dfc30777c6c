"""The giirl command as a person runs it: a process group of its own, everything it starts known, nothing left."""

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
LOOK_S = 0.2
GONE_S = 20.0  # after the command has ended, for what it started to end too
ANSWER_S = 5.0  # of one HTTP request on loopback
LOOPBACK = urllib.request.build_opener(urllib.request.ProxyHandler({}))

Sample = dict[tuple[str, frozenset[tuple[str, str]]], float]


def short_folder() -> Path:
    """For temporary files: Ray and Chrome put sockets there, whose names have to stay short."""
    return Path(tempfile.mkdtemp(prefix="gt-", dir="/tmp"))


@contextmanager
def run_folder() -> Iterator[Path]:
    """A run that does not exist yet; gone with everything beside it once the block ends."""
    folder = short_folder()
    try:
        yield folder / "run"
    finally:
        shutil.rmtree(folder)


def scrape(address: str, timeout_s: float = ANSWER_S) -> Sample:
    """Every number that a metrics endpoint shows."""
    with LOOPBACK.open(f"http://{address}/metrics", timeout=timeout_s) as answer:
        families = text_string_to_metric_families(answer.read().decode())
        return {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}


def total(sample: Sample, name: str, **labels: str) -> float:
    """The sum of a metric over all labels that are not named here; 0 where there is none."""
    return sum(value for (found, having), value in sample.items() if found == name and labels.items() <= having)


class Command:
    """One `giirl ...` under way. Leaving the `with` block kills whatever is left of it."""

    def __init__(self, *words: str | Path, env: dict[str, str] | None = None, program: list[str] | None = None) -> None:
        self.words = [str(word) for word in words]
        self.temporary = short_folder()
        self._seen: set[psutil.Process] = set()
        self._files = [(self.temporary / name).open("wb+") for name in ("stdout", "stderr")]
        self.process = subprocess.Popen(
            [*(program or [sys.executable, "-m", "giirl"]), *self.words],
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
        for process in [*self.left(), psutil.Process(self.process.pid)] if self.process.poll() is None else self.left():
            kill(process)
        self.process.wait(timeout=GONE_S)
        for process in self.left():  # what was born while the others were killed
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
    def said(self) -> str:
        return self.out + self.err

    def look(self) -> list[psutil.Process]:
        """All processes below the command, which from now on are known however they are adopted."""
        try:
            below: list[psutil.Process] = psutil.Process(self.process.pid).children(recursive=True)
        except psutil.NoSuchProcess:
            below = []
        self._seen |= set(below)
        return below

    def left(self) -> list[psutil.Process]:
        """What the command started and still runs: by descent, or by its temporary folder in the command line."""
        found = [process for process in self._seen if alive(process)]
        for process in psutil.process_iter():
            if process not in found and str(self.temporary) in " ".join(command_line(process)) and alive(process):
                found.append(process)
        return [process for process in found if process.pid != self.process.pid]

    def until(self, true: Callable[[], bool], what: str, *, timeout_s: float = 90.0) -> None:
        """Wait for something to become true while the command runs."""
        deadline_s = time.monotonic() + timeout_s
        while not true():
            self.look()
            if self.process.poll() is not None:
                raise AssertionError(f"giirl ended with {self.process.returncode} before {what}:\n{self.err}")
            if time.monotonic() > deadline_s:
                raise AssertionError(f"no {what} within {timeout_s} s:\n{self.err}")
            time.sleep(LOOK_S)

    def stop(self, number: signal.Signals) -> None:
        """Ctrl-C reaches every process of the foreground group, as from a terminal; any other signal just one."""
        self.look()
        if number is signal.SIGINT:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)

    def wait(self, *, timeout_s: float = 90.0) -> int:
        """Its exit status."""
        deadline_s = time.monotonic() + timeout_s
        while self.process.poll() is None:
            if time.monotonic() > deadline_s:
                raise AssertionError(f"giirl {' '.join(self.words)} runs after {timeout_s} s:\n{self.err}")
            self.look()
            time.sleep(LOOK_S)
        return self.process.returncode

    def remains(self, *, timeout_s: float = GONE_S) -> list[str]:
        """What still runs some time after the command has ended, in words; empty is what everybody wants."""
        deadline_s = time.monotonic() + timeout_s
        while (left := self.left()) and time.monotonic() < deadline_s:
            time.sleep(LOOK_S)
        return [f"{process.pid} {' '.join(command_line(process))[:120]}" for process in left]


def find(command: Command, title: str) -> list[psutil.Process]:
    """The processes to which Ray gave this class's name, alive and not on their way out."""
    return [p for p in command.look() if alive(p) and " ".join(command_line(p)[:1]).startswith(title)]


def giirl(*words: str | Path, env: dict[str, str] | None = None, timeout_s: float = 90.0) -> tuple[int, str, list[str]]:
    """Run to the end: exit status, what it said, what still runs."""
    with Command(*words, env=env) as command:
        status = command.wait(timeout_s=timeout_s)
        return status, command.said, command.remains()


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
    """Without a chance to tidy up."""
    try:
        process.kill()
    except psutil.NoSuchProcess:
        return


def read_json(path: Path) -> Any:
    return json.loads(path.read_text())


def points(run: Path) -> list[dict[str, Any]]:
    """The learning curve of a run so far."""
    curve = run / "curve.jsonl"
    return [json.loads(line) for line in curve.read_text().splitlines()] if curve.exists() else []


def step(run: Path) -> int:
    """The last iteration of the curve, 0 before any."""
    return points(run)[-1]["step"] if points(run) else 0


def targets(run: Path) -> dict[str, str]:
    """Job -> address, from the file that a run keeps for Prometheus."""
    path = run / "prometheus.json"
    if not path.exists():
        return {}
    return {group["labels"]["process"]: group["targets"][0] for group in read_json(path)}


def try_scrape(run: Path, job: str) -> Sample:
    """What a process of the run shows now; nothing while it is down or starting."""
    try:
        return scrape(targets(run).get(job, "127.0.0.1:9"))
    except (urllib.error.URLError, OSError, json.JSONDecodeError):
        return {}
