"""A Ray cluster of one node, started with `ray start --head`, for submitted jobs and for drivers."""

from __future__ import annotations

import json
import os
import secrets
import socket
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tests.end_to_end.commands import HTTP_TIMEOUT_S, LOOPBACK, Command

PROGRAMS = Path(sys.executable).parent
RAY = str(PROGRAMS / "ray")
NODE = "127.0.0.2"  # Ray replaces 127.0.0.1 by the address of a network card, which may come and go


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
        *("start", "--head", "--block", "--disable-usage-stats", "--num-cpus=2", f"--node-ip-address={NODE}"),
        *(f"--port={port}", f"--dashboard-port={dashboard}", "--dashboard-host=127.0.0.1"),
        *(f"--dashboard-agent-listen-port={agent}", f"--ray-client-server-port={client}"),
        f"--object-store-memory={256 << 20}",
    ]
    head_env = {**env, "RAY_ADDRESS": ""}
    job_env = {**env, "RAY_ADDRESS": f"http://127.0.0.1:{dashboard}", "RAY": RAY}
    with Command(*words, program=[RAY], env=head_env) as head:
        head.until(lambda: _accepts_jobs(job_env), "response of the dashboard")
        yield head, job_env, {**env, "RAY_ADDRESS": f"{NODE}:{port}"}


PROBE = """
import json, logging, ray
ray.init(address="auto", namespace="giirl", logging_level=logging.ERROR, log_to_driver=False)
total, free = ray.cluster_resources(), ray.available_resources()
print(json.dumps({"actors": ray.util.list_named_actors(), "cpus_in_use": total["CPU"] - free.get("CPU", 0)}))
"""


def probe(driver_env: dict[str, str]) -> dict[str, Any]:
    """The `actors` of GIIRL in a cluster, by name, and its `cpus_in_use`."""
    with Command("-c", PROBE, program=[sys.executable], env=driver_env) as command:
        assert command.wait() == 0, command.output
        found: dict[str, Any] = json.loads(command.out.splitlines()[-1])
        return found


HOG = """
import logging, time, ray
ray.init(address="auto", logging_level=logging.ERROR, log_to_driver=False)
hog = ray.remote(type("Hog", (), {"ready": lambda self: None})).options(num_cpus=2).remote()
ray.get(hog.ready.remote())
print("hogging", flush=True)
time.sleep(600)
"""


@contextmanager
def all_cpus_taken(driver_env: dict[str, str]) -> Iterator[Command]:
    """In this block, or until the command is killed, another program uses all CPUs of the cluster."""
    with Command("-c", HOG, program=[sys.executable], env=driver_env) as hog:
        hog.until(lambda: "hogging" in hog.out, "an actor that takes all CPUs")
        yield hog


def _accepts_jobs(env: dict[str, str]) -> bool:
    """Whether jobs can be submitted; the dashboard itself is up earlier."""
    request = urllib.request.Request(f"{env['RAY_ADDRESS']}/api/jobs/")
    request.add_header("Authorization", f"Bearer {env['RAY_AUTH_TOKEN']}")
    try:
        with LOOPBACK.open(request, timeout=HTTP_TIMEOUT_S) as response:
            return bool(response.status == 200)
    except (urllib.error.URLError, OSError):
        return False
