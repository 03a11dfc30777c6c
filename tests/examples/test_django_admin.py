"""Django's admin as an example: its experts do what the goals ask for, by the database's own state."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest

from actors.agents import ExpertAgent, RandomAgent
from actors.browser import open_browser
from actors.rollouts import play_pages
from browser_farm.mixed import expert_of
from giirl_core.config import Config
from giirl_core.config_file import load_config
from giirl_core.gestures import BASIC
from giirl_core.metrics import Metrics
from giirl_core.types import Purpose
from tests.test_frame import ROOT

EXAMPLE = ROOT / "examples/django_admin"
PORT = "8010"  # in the task files

pytestmark = [pytest.mark.chrome, pytest.mark.slow]


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Config]:
    """The example's settings, with the task files of a server on a free port."""
    with closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    folder: Path = tmp_path_factory.mktemp("example")
    for name in ("data", "tasks", "experts.py"):
        copy = shutil.copytree if (EXAMPLE / name).is_dir() else shutil.copy
        copy(EXAMPLE / name, folder / name)
    for file in (folder / "tasks").glob("*.toml"):
        file.write_text(file.read_text().replace(f":{PORT}/", f":{port}/"))
    command = [sys.executable, str(EXAMPLE / "serve.py"), port]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        assert port in server.stdout.readline()
        yield load_config(EXAMPLE / "config.toml", [f'tasks=["{folder / "tasks"}/"]', "actors.tabs=2"])
        server.terminate()
        assert server.wait(timeout=20) == 0


def test_the_experts_do_what_each_of_the_five_kinds_asks_for(config: Config) -> None:
    with closing(open_browser(config, Metrics())) as browser:
        played = play_pages(config, browser, ExpertAgent(expert_of), Purpose.DEMONSTRATE, 2, Metrics())
    assert len(config.tasks) == 5
    assert sorted(e.trajectory.task for e in played if e.outcome.success) == sorted(2 * config.tasks)
    for episode in played:
        episode.trajectory.choices(BASIC)


def test_random_actions_do_not_pass_the_checks(config: Config) -> None:
    with closing(open_browser(config, Metrics())) as browser:
        played = play_pages(config, browser, RandomAgent(), Purpose.RANDOM, 1, Metrics())
    assert not any(episode.outcome.success for episode in played)


def test_many_episodes_may_begin_at_once(config: Config) -> None:
    found = re.search(r"http://127\.0\.0\.1:\d+", Path(config.tasks[0]).read_text())
    assert found is not None

    def begin(index: int) -> int:
        with urllib.request.urlopen(f"{found[0]}/begin/{index:032x}/", timeout=60) as reply:
            status: int = reply.status
        return status

    with ThreadPoolExecutor(16) as threads:
        assert set(threads.map(begin, range(300))) == {200}
