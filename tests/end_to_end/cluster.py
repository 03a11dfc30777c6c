"""A Ray cluster of one node, as `ray start --head` makes it, for jobs and for drivers that come and go."""

from __future__ import annotations

import os
import secrets
import socket
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from tests.end_to_end.commands import ANSWER_S, LOOPBACK, Command

PROGRAMS = Path(sys.executable).parent
RAY = str(PROGRAMS / "ray")


@contextmanager
def ray_cluster() -> Iterator[tuple[Command, dict[str, str], dict[str, str]]]:
    """On free ports; yields its head, and the environments with which jobs and drivers reach it."""
    with ExitStack() as sockets:
        free = [sockets.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(4)]
        port, dashboard, agent, client = [server.getsockname()[1] for server in free]
    env = {
        "PATH": f"{PROGRAMS}:{os.environ['PATH']}",
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_worker_niceness": "0",  # nobody else's work may starve ours
    }
    words = [
        *("start", "--head", "--block", "--disable-usage-stats", "--num-cpus=2", "--node-ip-address=127.0.0.1"),
        *(f"--port={port}", f"--dashboard-port={dashboard}", "--dashboard-host=127.0.0.1"),
        *(f"--dashboard-agent-listen-port={agent}", f"--ray-client-server-port={client}"),
        f"--object-store-memory={256 << 20}",
    ]
    own = {**env, "RAY_ADDRESS": "", "RAY_JOB_STOP_WAIT_TIME_S": "60"}
    jobs = {**env, "RAY_ADDRESS": f"http://127.0.0.1:{dashboard}", "RAY": RAY}
    with Command(*words, program=[RAY], env=own) as head:
        head.until(lambda: _answers(jobs), "answer of the dashboard")
        yield head, jobs, {**env, "RAY_ADDRESS": f"127.0.0.1:{port}"}


def _answers(env: dict[str, str]) -> bool:
    """Whether jobs can be submitted: the dashboard itself comes up earlier."""
    request = urllib.request.Request(f"{env['RAY_ADDRESS']}/api/jobs/")
    request.add_header("Authorization", f"Bearer {env['RAY_AUTH_TOKEN']}")
    try:
        with LOOPBACK.open(request, timeout=ANSWER_S) as answer:
            return bool(answer.status == 200)
    except (urllib.error.URLError, OSError):
        return False
