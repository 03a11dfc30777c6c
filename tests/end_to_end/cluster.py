"""A Ray cluster of one node, started with `ray start --head`, for submitted jobs and for drivers."""

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

from tests.end_to_end.commands import HTTP_TIMEOUT_S, LOOPBACK, Command

PROGRAMS = Path(sys.executable).parent
RAY = str(PROGRAMS / "ray")


@contextmanager
def ray_cluster() -> Iterator[tuple[Command, dict[str, str], dict[str, str]]]:
    """A cluster on free ports. Yields its head process and the environment variables for jobs and for drivers."""
    with ExitStack() as sockets:
        free = [sockets.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(4)]
        port, dashboard, agent, client = [server.getsockname()[1] for server in free]
    env = {
        "PATH": f"{PROGRAMS}:{os.environ['PATH']}",
        "RAY_AUTH_MODE": "token",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_worker_niceness": "0",  # other programs must not starve the workers
    }
    words = [
        *("start", "--head", "--block", "--disable-usage-stats", "--num-cpus=2", "--node-ip-address=127.0.0.1"),
        *(f"--port={port}", f"--dashboard-port={dashboard}", "--dashboard-host=127.0.0.1"),
        *(f"--dashboard-agent-listen-port={agent}", f"--ray-client-server-port={client}"),
        f"--object-store-memory={256 << 20}",
    ]
    head_env = {**env, "RAY_ADDRESS": "", "RAY_JOB_STOP_WAIT_TIME_S": "60"}
    job_env = {**env, "RAY_ADDRESS": f"http://127.0.0.1:{dashboard}", "RAY": RAY}
    with Command(*words, program=[RAY], env=head_env) as head:
        head.until(lambda: _accepts_jobs(job_env), "response of the dashboard")
        yield head, job_env, {**env, "RAY_ADDRESS": f"127.0.0.1:{port}"}


def _accepts_jobs(env: dict[str, str]) -> bool:
    """Whether jobs can be submitted; the dashboard itself is up earlier."""
    request = urllib.request.Request(f"{env['RAY_ADDRESS']}/api/jobs/")
    request.add_header("Authorization", f"Bearer {env['RAY_AUTH_TOKEN']}")
    try:
        with LOOPBACK.open(request, timeout=HTTP_TIMEOUT_S) as response:
            return bool(response.status == 200)
    except (urllib.error.URLError, OSError):
        return False
