"""The HTTP server of a process: /metrics, /healthz, /readyz, and /targets where a process knows the others."""

from __future__ import annotations

import socket
import socketserver
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

from giirl_core.telemetry.health import Health

CLIENT_TIMEOUT_S = 5.0  # of a client that sends or reads nothing
TEXT = "text/plain; charset=utf-8"


@dataclass(frozen=True, slots=True, kw_only=True)
class Endpoints:
    """What a process answers."""

    metrics: Callable[[str], tuple[bytes, str]]  # from the header "Accept" to a body and its content type
    health: Health
    targets: Callable[[], bytes]  # Prometheus's HTTP service discovery


class TelemetryServer:
    """Answers scrapes and probes until `close`, in threads of its own.

    Listens on the first free port of `ports`; ValueError when there is none.
    """

    def __init__(self, host: str, ports: range, endpoints: Endpoints) -> None:
        self._server = _bind(host, ports, endpoints)
        self.port: int = self._server.server_address[1]
        self._thread = Thread(target=self._server.serve_forever, name="telemetry", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop serving and release the port."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(timeout=5)


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, host: str, port: int, endpoints: Endpoints) -> None:
        self.endpoints = endpoints
        self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        super().__init__((host, port), _Handler)

    def server_bind(self) -> None:
        """Bind without looking up the name of the host, which takes seconds where no name server answers."""
        socketserver.TCPServer.server_bind(self)

    def handle_error(self, request: object, client_address: object) -> None:
        """Do nothing: a client that goes away is no error of this process."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = CLIENT_TIMEOUT_S

    def do_GET(self) -> None:
        endpoints = self.server.endpoints
        match self.path.partition("?")[0]:
            case "/metrics" | "/":
                self._answer(*endpoints.metrics(self.headers.get("Accept", "")))
            case "/healthz":
                self._answer_probe(endpoints.health.hung)
            case "/readyz":
                self._answer_probe(endpoints.health.unready)
            case "/targets":
                self._answer(endpoints.targets(), "application/json")
            case _:
                self.send_error(HTTPStatus.NOT_FOUND)

    def log_message(self, format: str, *values: object) -> None:
        """Do nothing: a scrape is not worth a line."""

    def _answer_probe(self, problem: str) -> None:
        status = HTTPStatus.SERVICE_UNAVAILABLE if problem else HTTPStatus.OK
        self._answer(f"{problem or 'ok'}\n".encode(), TEXT, status)

    def _answer(self, body: bytes, content_type: str, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", content_type)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


def _bind(host: str, ports: range, endpoints: Endpoints) -> _Server:
    for port in ports:
        try:
            return _Server(host, port, endpoints)
        except (OSError, OverflowError) as error:
            reason = error
    where = f"{host}:{ports[0]}" + (f" to {ports[-1]}" if len(ports) > 1 else "")
    raise ValueError(f"metrics cannot listen on {where}: {reason}; wanted a free port, or 0")
