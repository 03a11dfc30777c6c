"""One websocket to Chrome's debugger: many tabs, many calls at once, and no wait without a deadline."""

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

SEND_S = 5.0  # for Chrome to read what is written to it
BROWSER = ""  # the session that speaks to the browser itself instead of to a tab

Json = dict[str, Any]
EventHandler = Callable[[str, str, Json], None]  # session, method, params


class BrowserGone(Exception):
    """The websocket is closed: Chrome has ended, or nobody can speak to it any more."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """What came of one call: a result, or Chrome's own words on why there is none."""

    result: Json
    error: str = ""


class DevTools:
    """Sends calls and receives their replies; events that arrive meanwhile go to `on_event`."""

    def __init__(self, url: str, *, timeout_s: float, on_event: EventHandler) -> None:
        self._on_event = on_event
        self._next_id = 0
        self._replies: dict[int, Reply] = {}
        self._awaited: set[int] = set()
        address = urlsplit(url)
        try:
            # A socket of our own: the library would go to this machine through a proxy of the environment.
            connection = socket.create_connection((address.hostname, address.port), timeout=timeout_s)
            self._socket = websocket.create_connection(
                url,
                timeout=timeout_s,
                suppress_origin=True,  # Chrome refuses origins it was not told of
                skip_utf8_validation=True,  # json decodes it anyway; checking twice costs more than the rest
                enable_multithread=False,
                socket=connection,
            )
        except (OSError, websocket.WebSocketException) as error:
            raise BrowserGone(f"no connection to Chrome at {url}: {error}") from error

    def send(self, session: str, method: str, params: Mapping[str, Any] | None = None) -> int:
        """Start a call and return its id; `receive` waits for what comes of it."""
        call = self._write(session, method, params)
        self._awaited.add(call)
        return call

    def post(self, session: str, method: str, params: Mapping[str, Any] | None = None) -> None:
        """Start a call whose reply nobody wants, safe to use inside an event handler."""
        self._write(session, method, params)

    def receive(
        self, calls: Iterable[int], *, deadline: float, given_up: Callable[[], set[int]], again: bool = False
    ) -> dict[int, Reply]:
        """Replies to `calls` that came before `deadline` (time.monotonic); a call that did not is missing.

        `given_up` names calls that no longer can be answered, because their tab has crashed. A late reply is thrown
        away, unless its call is to be received `again`.
        """
        waiting = set(calls)
        replies: dict[int, Reply] = {}
        while True:
            for call in waiting & self._replies.keys():
                replies[call] = self._replies.pop(call)
                waiting.discard(call)
            waiting -= given_up()
            if not waiting or not self.pump(deadline):
                break
        if not again:
            self._awaited -= waiting
        return replies

    def call(self, session: str, method: str, params: Mapping[str, Any] | None = None, *, timeout_s: float) -> Json:
        """One call and its result; TimeoutError when it is not answered, RuntimeError when Chrome refuses."""
        call = self.send(session, method, params)
        reply = self.receive([call], deadline=time.monotonic() + timeout_s, given_up=set).get(call)
        if reply is None:
            raise TimeoutError(f"Chrome did not answer {method} in {timeout_s:g} s")
        if reply.error:
            raise RuntimeError(f"Chrome refused {method}: {reply.error}")
        return reply.result

    def pump(self, deadline: float) -> bool:
        """Take one message off the socket; False when none came before `deadline`."""
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
        elif call in self._awaited:
            self._awaited.discard(call)
            error_words = message.get("error", {}).get("message", "")
            self._replies[call] = Reply(result=message.get("result", {}), error=error_words)
        return True

    def close(self) -> None:
        self._socket.shutdown()  # type: ignore[no-untyped-call]

    def _write(self, session: str, method: str, params: Mapping[str, Any] | None) -> int:
        self._next_id += 1
        message: Json = {"id": self._next_id, "method": method, "params": params or {}}
        if session:
            message["sessionId"] = session
        try:
            self._socket.settimeout(SEND_S)  # not what is left of some earlier wait
            self._socket.send(json.dumps(message))
        except (OSError, websocket.WebSocketException) as error:
            raise BrowserGone(f"Chrome closed its debugger connection: {error}") from error
        return self._next_id


def browser_url(debugger_address: str, *, timeout_s: float) -> str:
    """The websocket of the browser itself, asked of Chrome's debugger at host:port."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(f"http://{debugger_address}/json/version", timeout=timeout_s) as response:
            return str(json.load(response)["webSocketDebuggerUrl"])
    except (OSError, ValueError, KeyError) as error:
        raise BrowserGone(f"Chrome's debugger at {debugger_address} does not answer: {error}") from error
