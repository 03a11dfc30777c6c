"""`deploy/submit.sh`: what it asks the dashboard of a Ray cluster, and what it says when no answer comes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
CLOSED = "http://127.0.0.1:1"  # nothing listens there
PROXIES = dict.fromkeys(("http_proxy", "HTTP_PROXY", "https_proxy", "all_proxy"), CLOSED)


def submit(address: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "RAY": str(Path(sys.executable).parent / "ray"), "RAY_ADDRESS": address, **variables}
    command = ["deploy/submit.sh", "experiments/miniwob_four.toml"]
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=100, check=False)


class Dashboard(BaseHTTPRequestHandler):
    """Simulated: it knows the version and an empty list of jobs, and refuses to take one."""

    asked: list[str]

    def answer(self, status: int, body: Any) -> None:
        self.asked.append(f"{self.command} {self.path}")
        text = json.dumps(body).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def do_GET(self) -> None:
        if self.path == "/api/version":
            self.answer(200, {"version": "4", "ray_version": "2.60.0", "ray_commit": ""})
        else:
            self.answer(200, [] if self.path == "/api/jobs/" else {})

    def do_POST(self) -> None:
        self.answer(500, "no job is taken")

    def log_message(self, format: str, *words: Any) -> None:
        """Write no log."""


@pytest.fixture
def dashboard() -> Iterator[tuple[str, list[str]]]:
    handler = type("Handler", (Dashboard,), {"asked": []})
    with HTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", handler.asked  # type: ignore[attr-defined]
        server.shutdown()
        thread.join(timeout=10)


def test_no_proxy_stands_between_a_machine_and_its_own_dashboard(dashboard: tuple[str, list[str]]) -> None:
    address, asked = dashboard
    submit(address, **PROXIES)
    assert "GET /api/jobs/" in asked
    assert "POST /api/jobs/" in asked or any(line.startswith(("GET /api/packages", "PUT")) for line in asked)


def test_the_hosts_that_a_user_takes_out_of_the_proxy_stay_so(tmp_path: Path) -> None:
    ray = tmp_path / "ray"
    ray.write_text("#!/bin/sh\necho $no_proxy\n")
    ray.chmod(0o755)
    done = submit("http://127.0.0.1:1", RAY=str(ray), NO_PROXY="cluster.example")
    assert done.stdout == "cluster.example,127.0.0.1,localhost,::1\n"


def test_a_dashboard_that_does_not_answer_is_one_line() -> None:
    done = submit(CLOSED)
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"submit: no dashboard of Ray answers at {CLOSED}: ")
