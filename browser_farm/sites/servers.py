"""Two small servers on loopback: one refuses what a page may not reach, one serves the HTML files of a task."""

from __future__ import annotations

import functools
import socketserver
import threading
from collections import Counter
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

HEAD_BYTES = 8192
HEAD_TIMEOUT_S = 5.0


class Refuser:
    """The proxy of every browser context: Chrome sends it all requests but those to allowed origins.

    It closes each connection without an answer, which a page sees as a network error, and never connects anywhere.
    `refused` counts the requests by host and port.
    """

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self._lock = threading.Lock()
        refuser = self

        class Handler(socketserver.StreamRequestHandler):
            timeout = HEAD_TIMEOUT_S

            def handle(self) -> None:
                try:
                    words = self.rfile.readline(HEAD_BYTES).decode("latin-1").split()
                    if len(words) >= 2:
                        refuser.count(words[1])
                except OSError:
                    return  # the browser has closed the connection

        self._server = _Server(("127.0.0.1", 0), Handler)
        _serve(self._server)
        self.address = f"127.0.0.1:{self._server.server_address[1]}"

    def count(self, target: str) -> None:
        """Count one refused request to an address, or to host:port."""
        host = target.split("://")[-1].split("/")[0]
        with self._lock:
            self.refused[host] += 1

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()


class FolderServer:
    """Serves the files of one folder on a free loopback port."""

    def __init__(self, folder: Path) -> None:
        handler = functools.partial(_Files, directory=str(folder))
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        _serve(self._server)
        self.origin = f"http://127.0.0.1:{self._server.server_port}"

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()


class _Server(socketserver.ThreadingTCPServer):
    daemon_threads = True
    request_queue_size = 128


class _Files(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: requests are not news."""


def _serve(server: socketserver.BaseServer) -> None:
    threading.Thread(target=server.serve_forever, daemon=True, name="giirl-loopback").start()
