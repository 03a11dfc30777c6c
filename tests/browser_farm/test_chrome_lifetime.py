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
from browser_farm.gym.env import MiniWoB
from giirl_core.types import EpisodeSpec
from tests.browser_farm import machines

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
        with contextlib.suppress(psutil.NoSuchProcess):  # Chrome's first renderer ends by itself
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
    with pytest.raises(
        RuntimeError, match=f"^cannot create a folder .*{why}|^Chrome cannot use its folder .*{why}"
    ) as caught:
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


@pytest.mark.parametrize(
    ("behaviour", "why"),
    [
        ("exit 1", "did not start: it said nothing"),
        ("sleep 60", "did not start within 2 s: it said nothing"),
        ("echo Killed >&2; sleep 60", "did not start within 2 s: it said nothing"),  # as its shell may say at the end
    ],
)
def test_a_chrome_that_never_starts_raises_a_one_line_error_after_three_attempts(
    behaviour: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GIIRL_CHROME", str(machines.counted(tmp_path, behaviour)))
    with pytest.raises(RuntimeError, match=f"Chrome did not start in 3 attempts: .*chrome {why}") as caught:
        ChromeFarm(tabs=1, launch_timeout_s=2.0)
    assert "\n" not in str(caught.value)
    assert machines.starts(tmp_path) == 3


def test_chrome_ignores_ctrl_c_in_its_owners_terminal_and_proxy_settings(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("http_proxy", "HTTP_PROXY", "https_proxy", "all_proxy"):
        monkeypatch.setenv(name, "http://127.0.0.1:1")
    with ChromeFarm(tabs=1) as farm:
        pids = reaper.processes(Path(farm.chrome_directory))
        assert not any(os.getpgid(pid) == os.getpgid(0) or os.getsid(pid) == os.getsid(0) for pid in pids)
        assert farm.reset({0: EpisodeSpec(task="click-test", seed=1)})[0].goal.utterance == "Click the button."


AS_PROCESS_1 = """
import os, signal
from pathlib import Path
from browser_farm.chrome import reaper
from browser_farm.farm import ChromeFarm
from giirl_core.types import Command, EpisodeSpec, Verb

def others():
    return [entry.name for entry in Path("/proc").iterdir() if entry.name.isdigit() and entry.name != "1"]

def zombies():
    return [pid for pid in others() if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"]

assert os.getpid() == 1
with ChromeFarm(tabs=1) as farm:
    farm.reset({0: EpisodeSpec(task="click-test", seed=1)})
    for pid in reaper.processes(Path(farm.chrome_directory)):
        os.kill(pid, signal.SIGKILL)
    assert farm.step({0: Command(verb=Verb.WAIT)})[0].lost == "browser_died"
    print("zombies after a relaunch:", zombies())
print("processes after the end:", others())
"""


def test_as_process_1_of_a_container_a_killed_chrome_and_an_ended_one_leave_no_zombies() -> None:
    done = machines.run(machines.PROCESS_1, "-c", AS_PROCESS_1)
    assert done.stdout.splitlines() == ["zombies after a relaunch: []", "processes after the end: []"], done.stderr


def in_a_fork(act: Callable[[], object]) -> str:
    """What `act` returns or raises in a forked child of this process, as text."""
    read, write = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.write(write, str(act()).encode())
        except RuntimeError as error:
            os.write(write, str(error).encode())
        finally:
            os._exit(0)
    os.close(write)
    os.waitpid(pid, 0)
    with os.fdopen(read) as said:
        return said.read()


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_fork_neither_ends_nor_uses_the_chrome_of_its_parent() -> None:
    env = MiniWoB("click-test")
    try:
        env.reset(seed=1)
        assert isinstance(env._farm, ChromeFarm)
        started = reaper.processes(Path(env._farm.chrome_directory))
        assert "must open another" in in_a_fork(lambda: env.reset(seed=2))
        assert in_a_fork(env.close) == "None"
        assert reaper.processes(Path(env._farm.chrome_directory)) == started
        assert "lost" not in env.step(None)[4]
    finally:
        env.close()


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_chrome_ends_with_its_farm_although_a_fork_of_the_owner_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("browser_farm.chrome.reaper.TIMEOUT_S", 1e9)  # an end by force would never come
    farm = ChromeFarm(tabs=1)
    directory = Path(farm.chrome_directory)
    pid = os.fork()
    if pid == 0:
        time.sleep(600)
        os._exit(0)
    try:
        farm.close()
        assert reaper.processes(directory) == set()
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


WITHOUT_PIDFD = """
import os, sys
from pathlib import Path
from browser_farm.chrome import reaper

def refuse(pid):
    raise OSError(38, "Function not implemented")

os.pidfd_open = refuse
reaper.main(Path(sys.argv[1]), os.getppid(), ["sleep", "600"])
"""


def test_the_reaper_needs_no_pidfd_which_some_containers_refuse(tmp_path: Path) -> None:
    owner = subprocess.Popen([sys.executable, "-c", WITHOUT_PIDFD, tmp_path], cwd=ROOT, stdin=subprocess.PIPE)
    deadline = time.monotonic() + 30
    while not reaper.processes(tmp_path) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(reaper.processes(tmp_path)) == 1
    owner.communicate(b"end", timeout=30)
    assert reaper.processes(tmp_path) == set()
