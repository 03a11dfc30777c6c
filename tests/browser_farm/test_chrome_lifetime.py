"""A farm's Chrome starts and ends with its owner, in whatever way the owner ends."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from benchmarks import relaunches
from browser_farm.chrome import reaper
from browser_farm.farm import ChromeFarm
from giirl_core.types import EpisodeSpec

pytestmark = pytest.mark.chrome

ROOT = Path(__file__).resolve().parents[2]

OWNER = """
import sys, time
from browser_farm.farm import ChromeFarm
farm = ChromeFarm(tabs=1)
print(farm.chrome_directory, flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("kill_first", ["", "chromedriver"])
def test_no_chrome_outlives_an_owner_that_was_killed(kill_first: str) -> None:
    owner = subprocess.Popen([sys.executable, "-c", OWNER], cwd=ROOT, stdout=subprocess.PIPE)
    assert owner.stdout is not None
    directory = Path(owner.stdout.readline().decode().strip())
    started = reaper.processes(directory)
    assert len(started) > 3
    for pid in started:
        if kill_first and psutil.Process(pid).name().startswith(kill_first):
            os.kill(pid, signal.SIGKILL)  # Chrome becomes an orphan before its owner dies
    owner.kill()
    owner.communicate()
    deadline = time.monotonic() + 15
    while (reaper.processes(directory) or directory.exists()) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert reaper.processes(directory) == set()
    assert not directory.exists()


@pytest.mark.slow
def test_repeated_relaunches_leave_no_processes_or_files_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory(prefix="fr-", dir="/tmp") as name:  # short: Chrome's socket paths are limited
        folder = Path(name)
        monkeypatch.setattr("tempfile.tempdir", name)
        counts = relaunches.run(3, folder)
        assert counts["after"] == counts["before"]
        assert counts["before"]["chromes"] == counts["before"]["folders"] == 1
        assert list(folder.glob("giirl-chrome-*")) == []


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Path]]:
    """A function that mounts a file system with the given options as the temporary directory."""
    if os.geteuid() != 0 or shutil.which("mount") is None:
        pytest.skip("only root may mount a file system")
    folder = Path(tempfile.mkdtemp(prefix="fd-", dir="/tmp"))

    def mount(options: str) -> Path:
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True)
        if done.returncode != 0:
            pytest.skip(f"no file system may be mounted here: {done.stderr.decode().strip()}")
        monkeypatch.setattr("tempfile.tempdir", str(folder))
        return folder

    yield mount
    subprocess.run(["umount", "-l", str(folder)], capture_output=True)
    folder.rmdir()


@pytest.mark.parametrize(
    ("options", "why"), [("ro", "Read-only file system"), ("size=4k,nr_inodes=2", "No space left on device")]
)
def test_a_profile_that_cannot_be_written_raises_a_one_line_error(
    disk: Callable[[str], Path], options: str, why: str
) -> None:
    folder = disk(options)
    with pytest.raises(RuntimeError, match=f"Chrome did not start in 3 attempts: .*{why}") as caught:
        ChromeFarm(tabs=1, launch_timeout_s=20.0)
    assert "\n" not in str(caught.value)
    assert list(folder.iterdir()) == []


def test_a_disk_that_fills_up_during_episodes_does_not_stop_them(disk: Callable[[str], Path]) -> None:
    folder = disk("size=200m")
    with ChromeFarm(tabs=1, call_timeout_s=20.0) as farm:
        farm.reset({0: EpisodeSpec(task="click-test", seed=1)})
        with contextlib.suppress(OSError), (folder / "filler").open("wb") as filler:
            while True:
                filler.write(b"x" * (1 << 20))
                filler.flush()
        for task in ("click-button", "enter-text"):
            assert farm.reset({0: EpisodeSpec(task=task, seed=1)})[0].goal.tokens


def test_closing_twice_is_allowed_and_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    farm = ChromeFarm(tabs=1)
    directory = Path(farm.chrome_directory)
    pids = reaper.processes(directory)
    farm.close()
    farm.close()
    assert not directory.exists()
    assert not any(psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie" for pid in pids)
    with pytest.raises(RuntimeError, match="closed"):
        farm.reset({})


@pytest.mark.parametrize("behaviour", ["exit 1", "sleep 60"])
def test_a_chrome_that_never_starts_raises_a_one_line_error_after_three_attempts(
    behaviour: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "chrome"
    program.write_text(f"#!/bin/sh\necho started >> {tmp_path}/log\n{behaviour}\n")
    program.chmod(0o700)
    monkeypatch.setenv("GIIRL_CHROME", str(program))
    with pytest.raises(RuntimeError, match=r"Chrome did not start in 3 attempts: .*chrome did not start") as caught:
        ChromeFarm(tabs=1, launch_timeout_s=2.0)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "log").read_text().count("started") == 3


def test_chrome_ignores_ctrl_c_in_its_owners_terminal_and_proxy_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("http_proxy", "HTTP_PROXY", "https_proxy", "all_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:1")
    with ChromeFarm(tabs=1) as farm:
        pids = reaper.processes(Path(farm.chrome_directory))
        assert not any(os.getpgid(pid) == os.getpgid(0) or os.getsid(pid) == os.getsid(0) for pid in pids)
        assert farm.reset({0: EpisodeSpec(task="click-test", seed=1)})[0].goal.utterance == "Click the button."
