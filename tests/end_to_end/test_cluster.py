"""A run as a job of a Ray cluster, submitted as deploy/README.md says."""

from __future__ import annotations

import os
import re
import secrets
import socket
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.end_to_end.commands import ANSWER_S, LOOPBACK, ROOT, Command, read_json, run_folder, step

pytestmark = [pytest.mark.ray, pytest.mark.timeout(400)]

PROGRAMS = Path(sys.executable).parent
TINY = """
browser = "fake"
tasks = ["click-test-2"]
iterations = 4
rollout_batch = 4
net = {vectors = "hashed", width = 16}
demos = {per_task = 4}
evaluate = {episodes = 4, floor_episodes = 4}
"""


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with run_folder() as run:
        yield run.parent


@pytest.fixture(scope="module")
def cluster() -> Iterator[dict[str, str]]:
    """A head of its own on free ports; yields the environment that reaches it."""
    with ExitStack() as sockets:
        free = [sockets.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(4)]
        port, dashboard, agent, client = [server.getsockname()[1] for server in free]
    env = {
        "PATH": f"{PROGRAMS}:{os.environ['PATH']}",
        "RAY_ADDRESS": f"http://127.0.0.1:{dashboard}",
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY": str(PROGRAMS / "ray"),
    }
    words = [
        *("start", "--head", "--block", "--disable-usage-stats", "--num-cpus=2", "--node-ip-address=127.0.0.1"),
        *(f"--port={port}", f"--dashboard-port={dashboard}", "--dashboard-host=127.0.0.1"),
        *(f"--dashboard-agent-listen-port={agent}", f"--ray-client-server-port={client}"),
        f"--object-store-memory={256 << 20}",
    ]
    own = {**env, "RAY_ADDRESS": "", "RAY_JOB_STOP_WAIT_TIME_S": "60"}
    with Command(*words, program=[env["RAY"]], env=own) as head:
        head.until(lambda: _answers(env), "answer of the dashboard")
        yield env


def _answers(env: dict[str, str]) -> bool:
    """Whether jobs can be submitted: the dashboard itself comes up earlier."""
    request = urllib.request.Request(f"{env['RAY_ADDRESS']}/api/jobs/")
    request.add_header("Authorization", f"Bearer {env['RAY_AUTH_TOKEN']}")
    try:
        with LOOPBACK.open(request, timeout=ANSWER_S) as answer:
            return bool(answer.status == 200)
    except (urllib.error.URLError, OSError):
        return False


def test_a_submitted_job_trains_and_leaves_its_result_where_it_was_told(cluster: dict[str, str], folder: Path) -> None:
    config = folder / "tiny.toml"
    config.write_text(TINY)
    with Command(config, f"run={folder / 'run'}", program=[str(ROOT / "deploy/submit.sh")], env=cluster) as job:
        status = job.wait(timeout_s=150)
        assert status == 0, job.said
    assert step(folder / "run") == 4
    assert read_json(folder / "run/config.json")["runtime"] == "ray"
    assert read_json(folder / "run/result.json")["tasks"]["click-test-2"]["episodes"] == 4


def test_a_stopped_job_saves_its_run(cluster: dict[str, str], folder: Path) -> None:
    run = folder / "stopped"
    config = folder / "long.toml"
    config.write_text(TINY.replace("iterations = 4", "iterations = 100000"))
    with Command(config, f"run={run}", program=[str(ROOT / "deploy/submit.sh")], env=cluster) as job:
        job.until(lambda: step(run) > 0, "first iteration")
        name = re.findall(r"raysubmit_\w+", job.said)[0]
        with Command("job", "stop", name, program=[cluster["RAY"]], env=cluster) as stop:
            assert stop.wait() == 0, stop.said
        job.wait()
        assert f"stopped and saved; to go on: giirl train --resume {run}" in job.said
    assert (run / "checkpoints/latest").read_text().removesuffix("-again") == f"step-{step(run):08d}"


def test_a_job_with_a_setting_that_does_not_exist_fails_and_says_so(cluster: dict[str, str], folder: Path) -> None:
    words = ("job", "submit", "--", "giirl", "train", "iteration=4", f"run={folder / 'no'}", "runtime=ray")
    with Command(*words, program=[cluster["RAY"]], env=cluster) as job:
        status = job.wait()
        assert status != 0
        assert "there is no setting 'iteration'" in job.said
    assert not (folder / "no").exists()
