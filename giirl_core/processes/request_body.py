"""The body of an HTTP request is read at once, up to a size and a deadline, before the application sees the request."""

from __future__ import annotations

import asyncio

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MAX_BYTES = 1 << 20
READ_S = 10.0  # longest time from the head of a request to the end of its body


class BoundedBody:
    """ASGI middleware; a larger body is answered with 413, a slower one with 408, both without the application."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return await self._app(scope, receive, send)
        try:
            async with asyncio.timeout(READ_S):
                body = await _read(receive)
        except TimeoutError:
            answer = _refuse(408, f"the body: wanted all of it within {READ_S:.0f} s, got a part")
            return await answer(scope, receive, send)
        if len(body) > MAX_BYTES:
            return await _refuse(413, f"the body: wanted at most {MAX_BYTES} bytes, got more")(scope, receive, send)
        messages = iter([{"type": "http.request", "body": body}])

        async def replay() -> Message:
            return next(messages, None) or await receive()

        await self._app(scope, replay, send)


async def _read(receive: Receive) -> bytes:
    """The body. Of one that is too large only the beginning is kept; the client sends all before it reads an answer."""
    body = bytearray()
    more = True
    while more:
        message = await receive()
        if len(body) <= MAX_BYTES:
            body += message.get("body", b"")
        more = message.get("more_body", False)  # a client that goes away leaves what it has sent
    return bytes(body)


def _refuse(status: int, line: str) -> JSONResponse:
    return JSONResponse({"error": line}, status, {"Connection": "close"})
