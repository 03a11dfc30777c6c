"""A client for the Chrome DevTools Protocol: one websocket, many tabs, concurrent calls, a deadline on every wait.

https://chromedevtools.github.io/devtools-protocol/
"""

from __future__ import annotations

import json
import socket
import time
import urllib.request
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import websocket

SEND_TIMEOUT_S = 5.0
BROWSER = ""  # session id for calls to the browser itself instead of to a tab

Json = dict[str, Any]
EventHandler = Callable[[str, str, Json], None]  # session, method, params


class BrowserGone(Exception):
    """Chrome has ended, its websocket is closed, or it no longer answers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """The outcome of one call: a result, or Chrome's error message."""

    result: Json
    error: str = ""


class DevTools:
    """Sends calls and receives their replies; events that arrive in between are passed to `on_event`.

    Raises BrowserGone from every method once the connection is lost.
    """

    def __init__(self, url: str, *, timeout_s: float, on_event: EventHandler) -> None:
        self._on_event = on_event
        self._next_id = 0
        self._replies: dict[int, Reply] = {}
        self._pending: dict[int, str] = {}  # call id -> session
        self._abandoned: set[str] = set()  # sessions
        address = urlsplit(url)
        try:
            # Our own socket: websocket-client would use the proxy from the environment even for this machine.
            connection = socket.create_connection((address.hostname, address.port), timeout=timeout_s)
            self._socket = websocket.create_connection(
                url,
                timeout=timeout_s,
                suppress_origin=True,  # Chrome rejects origins that were not allowed on its command line
                skip_utf8_validation=True,  # json validates it anyway, and this check is the slowest part of recv
                enable_multithread=False,
                socket=connection,
            )
        except (OSError, websocket.WebSocketException) as error:
            raise BrowserGone(f"no connection to Chrome at {url}: {error}") from error

    def send(self, session: str, method: str, params: Mapping[str, Any] | None = None) -> int:
        """Start a call and return its id, for `receive`."""
        call = self._write(session, method, params)
        self._pending[call] = session
        return call

    def post(self, session: str, method: str, params: Mapping[str, Any] | None = None) -> None:
        """Start a call and ignore its reply. Safe to use inside an event handler."""
        self._write(session, method, params)

    def receive(self, calls: Iterable[int], *, timeout_s: float, periods: int = 1) -> dict[int, Reply]:
        """Replies to `calls` that arrive within `periods` times `timeout_s`; calls without a reply are missing.

        Calls to abandoned sessions are not waited for. Between two periods Chrome itself has to answer a call, else
        BrowserGone. A reply that arrives later is discarded.
        """
        sent = set(calls)
        replies: dict[int, Reply] = {}
        waiting = sent
        for period in range(periods):
            if period:
                self.check_alive(timeout_s=timeout_s / 2)
            deadline = time.monotonic() + timeout_s
            while (waiting := self._collect(waiting, replies)) and self.pump(deadline):
                pass
            if not waiting:
                break
        for call in sent - replies.keys():
            self._pending.pop(call, None)
        return replies

    def has_reply(self, call: int) -> bool:
        """Whether the reply to a call has arrived; `take` returns it."""
        return call in self._replies

    def take(self, call: int) -> Reply | None:
        """The reply to a call if it has arrived, else None; a reply that arrives later is discarded."""
        self._pending.pop(call, None)
        return self._replies.pop(call, None)

    def call(self, session: str, method: str, params: Mapping[str, Any] | None = None, *, timeout_s: float) -> Json:
        """Make one call and return its result; TimeoutError without a reply in time, RuntimeError if Chrome refuses."""
        call = self.send(session, method, params)
        reply = self.receive([call], timeout_s=timeout_s).get(call)
        if reply is None:
            raise TimeoutError(f"Chrome did not answer {method} in {timeout_s:g} s")
        if reply.error:
            raise RuntimeError(f"Chrome refused {method}: {reply.error}")
        return reply.result

    def check_alive(self, *, timeout_s: float) -> None:
        """Raise BrowserGone unless Chrome itself answers a call."""
        try:
            self.call(BROWSER, "Browser.getVersion", timeout_s=timeout_s)
        except TimeoutError as error:
            raise BrowserGone(str(error)) from error

    def abandon(self, sessions: Iterable[str]) -> None:
        """Stop waiting for replies from these sessions, now and later: their target has crashed or was closed."""
        self._abandoned.update(sessions)

    def pump(self, deadline: float) -> bool:
        """Process one incoming message; False when none arrives before `deadline` (time.monotonic)."""
        left_s = deadline - time.monotonic()
        if left_s <= 0:
            return False
        try:
            self._socket.settimeout(left_s)
            text = self._socket.recv()
        except websocket.WebSocketTimeoutException:
            return False
        except (OSError, websocket.WebSocketException) as error:
            raise BrowserGone(f"Chrome closed its debugger connection: {error}") from error
        if not text:
            raise BrowserGone("Chrome closed its debugger connection")
        message = json.loads(text)
        call = message.get("id")
        if call is None:
            self._on_event(message.get("sessionId", BROWSER), message["method"], message.get("params", {}))
        elif self._pending.pop(call, None) is not None:
            error_message = message.get("error", {}).get("message", "")
            self._replies[call] = Reply(result=message.get("result", {}), error=error_message)
        return True

    def close(self) -> None:
        self._socket.shutdown()  # type: ignore[no-untyped-call]

    def _collect(self, calls: set[int], replies: dict[int, Reply]) -> set[int]:
        """Move the replies that have arrived into `replies` and return the calls that can still be answered."""
        arrived = calls & self._replies.keys()
        for call in arrived:
            replies[call] = self._replies.pop(call)
        return {call for call in calls - arrived if self._pending[call] not in self._abandoned}

    def _write(self, session: str, method: str, params: Mapping[str, Any] | None) -> int:
        self._next_id += 1
        message: Json = {"id": self._next_id, "method": method, "params": params or {}}
        if session:
            message["sessionId"] = session
        try:
            self._socket.settimeout(SEND_TIMEOUT_S)  # replaces the timeout that an earlier recv has set
            self._socket.send(json.dumps(message))
        except (OSError, websocket.WebSocketException) as error:
            raise BrowserGone(f"Chrome closed its debugger connection: {error}") from error
        return self._next_id


def browser_url(debugger_address: str, *, timeout_s: float) -> str:
    """The websocket URL of the browser itself, from the debugger's HTTP endpoint at host:port."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(f"http://{debugger_address}/json/version", timeout=timeout_s) as response:
            return str(json.load(response)["webSocketDebuggerUrl"])
    except (OSError, ValueError, KeyError) as error:
        raise BrowserGone(f"Chrome's debugger at {debugger_address} does not answer: {error}") from error
