"""An HTTP server for an ASGI application: where it listens, and until when."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from threading import Event, Thread

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol

from giirl_core.processes.request_body import BoundedBody
from giirl_core.telemetry.targets import join_port

IDLE_S = 60  # a connection without a request is closed after this
GRACE_S = 5  # for requests that are under way when the server stops
MAX_CONNECTIONS = 100  # further ones are answered with 503
TICK_S = 0.2


class WebServer:
    """Serves one application. It listens from the start, and answers while `serve` runs."""

    def __init__(self, app: ASGIApp, *, host: str = "127.0.0.1", port: int = 0) -> None:
        """Port 0 takes any free one. ValueError where it cannot listen."""
        self._listener = _listen(host, port)
        self.address = "http://" + join_port(host, self._listener.getsockname()[1])
        self._server = uvicorn.Server(
            uvicorn.Config(
                BoundedBody(app),
                http=_Protocol,
                loop="asyncio",
                ws="none",
                lifespan="off",
                log_config=None,
                access_log=False,
                server_header=False,
                limit_concurrency=MAX_CONNECTIONS,
                timeout_keep_alive=IDLE_S,
                timeout_graceful_shutdown=GRACE_S,
            )
        )

    def serve(self, stop: Event, on_ready: Callable[[str], None] = lambda address: None) -> None:
        """Answer requests until `stop` is set; `on_ready` is called with the address.

        In a thread, because uvicorn would otherwise take the signals of the process for itself.
        """
        thread = Thread(target=self._server.run, kwargs={"sockets": [self._listener]}, name="http", daemon=True)
        thread.start()
        try:
            on_ready(self.address)
            while not stop.wait(TICK_S):
                if not thread.is_alive():
                    raise RuntimeError(f"the HTTP server on {self.address} has ended by itself")
        finally:
            self._server.should_exit = True
            thread.join(2 * GRACE_S)
            self.close()

    def close(self) -> None:
        """Listen no longer; for a server that never serves."""
        self._listener.close()


class _Protocol(H11Protocol):
    """Also closes a connection on which no request ever begins."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.timeout_keep_alive_task = self.loop.call_later(self.timeout_keep_alive, self.timeout_keep_alive_handler)


def _listen(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listener = socket.create_server((host, port), family=family, backlog=MAX_CONNECTIONS)
    except OSError as error:
        raise ValueError(f"cannot listen on {join_port(host, port)}: {error}; wanted a free port, or 0") from error
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # head and body are sent one after the other
    return listener
