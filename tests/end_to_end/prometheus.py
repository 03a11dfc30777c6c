"""A real Prometheus server that scrapes a run."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import urllib.error
import urllib.parse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.end_to_end.commands import CLEANUP_S, HTTP_TIMEOUT_S, LOOPBACK


class PrometheusQuery:
    """Sends queries to a Prometheus server."""

    def __init__(self, port: int) -> None:
        self._url = f"http://127.0.0.1:{port}/api/v1/query?"

    def __call__(self, query: str) -> list[dict[str, Any]]:
        try:
            with LOOPBACK.open(
                self._url + urllib.parse.urlencode({"query": query}), timeout=HTTP_TIMEOUT_S
            ) as response:
                rows: list[dict[str, Any]] = json.load(response)["data"]["result"]
                return rows
        except urllib.error.HTTPError as error:
            if error.code == 400:
                raise AssertionError(f"{query}: {error.read().decode()}") from None
            return []
        except (urllib.error.URLError, OSError):
            return []  # it is still starting


@contextmanager
def prometheus(folder: Path, discovery: str, rules: Path | None = None) -> Iterator[PrometheusQuery | None]:
    """A Prometheus server with its files in `folder`; None if Prometheus is not installed.

    `discovery` is the part of its settings that says where it finds targets.
    """
    program = shutil.which("prometheus")
    if program is None:
        yield None
        return
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    config = folder / "prometheus.yml"
    config.write_text(
        "global: {scrape_interval: 1s, evaluation_interval: 1s}\n"
        + (f"rule_files: [{rules}]\n" if rules else "")
        + f"scrape_configs: [{{job_name: giirl, {discovery}}}]\n"
    )
    process = subprocess.Popen(
        [
            program,
            f"--config.file={config}",
            f"--storage.tsdb.path={folder / 'tsdb'}",
            f"--web.listen-address=127.0.0.1:{port}",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield PrometheusQuery(port)
    finally:
        process.kill()
        process.wait(timeout=CLEANUP_S)
