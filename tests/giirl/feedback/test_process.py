"""`giirl feedback` as a process: it ends cleanly, a kill loses no answer, and a run learns from what was said."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from giirl.run.folder import RunFolder
from tests.giirl.feedback.examples import DEADLINE_S, Reply, fetch
from tests.giirl.small import run

pytestmark = pytest.mark.slow

START_S = 60.0
ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "run"
    run(path)
    return path


def giirl(*words: str | Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "giirl", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


@contextmanager
def feedback(path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server process for a run, and its address."""
    process = giirl("feedback", path)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/[\w-]{20,}/", address)
        yield process, address
    finally:
        process.kill()
        process.communicate(timeout=DEADLINE_S)


def asked(address: str, window: str) -> Reply:
    """The first page that asks about an episode."""
    deadline_s = time.monotonic() + START_S
    while "Did the policy do this" not in (reply := fetch(f"{address}?window={window}")).text:
        assert time.monotonic() < deadline_s, reply.text
        time.sleep(0.1)
    return reply


def answer(address: str, window: str, verb: str) -> str:
    found = re.search(r'name="key" value="([^"]+)"', asked(address, window).text)
    assert found is not None
    assert fetch(f"{address}{verb}", {"window": window, "key": found[1]}).status == 200
    return found[1]


def test_a_kill_loses_no_answer_and_the_next_server_asks_about_other_pages(small: Path) -> None:
    with feedback(small) as (process, address):
        first = {answer(address, "a", "right"), answer(address, "b", "wrong")}
        os.kill(process.pid, signal.SIGKILL)
        process.wait(DEADLINE_S)
    assert {path.name for path in (small / "feedback").iterdir()} == first
    with feedback(small) as (_, address):
        assert "Answers so far: 2" in asked(address, "a").text
        second = {answer(address, "a", "right") for _ in range(6)}
    assert not first & second
    assert {path.name for path in (small / "feedback").iterdir()} == first | second


@pytest.fixture
def hangup_ends_children() -> Iterator[None]:
    """Also where the tests run under nohup, whose children ignore it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("hangup_ends_children")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_it_cleanly_and_it_says_how_the_run_learns(number: signal.Signals, small: Path) -> None:
    with feedback(small) as (process, address):
        asked(address, "a")
        process.send_signal(number)
        out, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    assert f"to learn from them: giirl train --resume {small} iterations=5" in out
    assert "Traceback" not in out


def test_two_servers_for_one_run_are_refused(small: Path) -> None:
    with feedback(small):
        other = giirl("feedback", small)
        out, _ = other.communicate(timeout=START_S)
    assert other.returncode == 1
    assert out == f"giirl: another process uses {small / 'feedback'}: wait until it ends, or stop it\n"


def test_a_resumed_run_learns_from_the_answers(small: Path) -> None:
    with feedback(small) as (_, address):
        answer(address, "a", "wrong")
    resumed = giirl("train", "--resume", small, "iterations=6")
    out, _ = resumed.communicate(timeout=START_S)
    assert resumed.returncode == 0, out
    assert "answers of people that the run learns from:" in out
    assert "d_accuracy_feedback" in RunFolder(small).points()[-1]
