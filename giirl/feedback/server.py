"""The HTTP server of `giirl feedback`, on loopback: hands out pages and takes answers. All else is in `Desk`."""

from __future__ import annotations

import asyncio
import hmac
import secrets
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from urllib.parse import urlencode

from aiohttp import web

from giirl.feedback.desk import Desk
from giirl.feedback.page import Pages, Said
from giirl.feedback.stage import Stage
from giirl_core.files import explain
from giirl_core.wire.answers import Answer

HOST = "127.0.0.1"
MAX_REQUEST_BYTES = 1 << 16
CLOSING_S = 2.0  # for requests under way when the server ends
KEYS_JS = Path(__file__).with_name("keys.js")
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
Form = Mapping[str, str]
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class FeedbackServer:
    """Answers requests for `/TOKEN/...`. The token keeps other users of the machine out.

    A page is for one window, which names itself in its address: two windows never show the same episode.
    """

    def __init__(self, desk: Desk, stage: Stage, pages: Pages) -> None:
        self._desk, self._stage, self._pages = desk, stage, pages
        self.token = secrets.token_urlsafe(16)
        self._verbs: dict[str, Callable[[str, str, Form], str]] = {
            "right": self._right,
            "wrong": self._wrong,
            "skip": self._skip,
            "show": self._show,
            "keep": self._keep,
            "again": self._again,
            "drop": self._drop,
        }

    async def serve(self, port: int, on_ready: Callable[[str], None], stop: asyncio.Event) -> None:
        """Serve until `stop`. OSError if the port is in use."""
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_REQUEST_BYTES)
        app.router.add_get("/{token}/", self._get)
        app.router.add_get("/{token}/keys.js", self._keys)
        app.router.add_post("/{token}/{verb}", self._post)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=CLOSING_S)
        await runner.setup()
        try:
            site = web.TCPSite(runner, HOST, port)
            await site.start()
            found: int = runner.addresses[0][1]
            on_ready(f"http://{HOST}:{found}/{self.token}/")
            await stop.wait()
        finally:
            await runner.cleanup()

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """404 for everything without the token, and headers that keep pages out of caches and frames."""
        given = request.path.split("/")[1]
        if not hmac.compare_digest(given.encode(), self.token.encode()):
            raise web.HTTPNotFound(text="not found: wanted the address that giirl feedback printed\n")
        response = await handler(request)
        response.headers.update(HEADERS)
        return response

    async def _keys(self, request: web.Request) -> web.StreamResponse:
        return web.Response(text=KEYS_JS.read_text(encoding="utf-8"), content_type="text/javascript")

    async def _get(self, request: web.Request) -> web.StreamResponse:
        window = request.query.get("window", "")
        if not window:
            raise web.HTTPSeeOther(f"?{urlencode({'window': secrets.token_hex(4)})}")
        try:
            return _html(self._state(window, request.query.get("episode", ""), request.query.get("last", "")))
        except LookupError:
            raise web.HTTPSeeOther(_address(window)) from None

    async def _post(self, request: web.Request) -> web.StreamResponse:
        """Do what a form asks for; then the window gets its next page, or the same page with what is wrong."""
        form = {name: value for name, value in (await request.post()).items() if isinstance(value, str)}
        verb, window, key = self._verbs.get(request.match_info["verb"]), form.get("window", ""), form.get("key", "")
        if verb is None or not window:
            raise web.HTTPBadRequest(text=f"wanted one of {', '.join(self._verbs)}, with a window and a key\n")
        try:
            following = await asyncio.to_thread(verb, window, key, form)
        except LookupError:  # of an earlier server; the page is played again
            following = _address(window)
        except (ValueError, OSError) as error:  # OSError: nothing was written
            said = Said(step=_step(form), right_for=form.get("right_for", ""), error=explain(error))
            page = self._pages.ask(window, self._desk.lent(key), said, self._desk.answers, "")
            return _html(page, status=422 if isinstance(error, ValueError) else 500)
        raise web.HTTPSeeOther(following)

    def _state(self, window: str, episode: str, last: str) -> str:
        """The page that a window shows now; with `episode`, that one again."""
        candidate = self._desk.lent(episode) if episode else self._desk.take(window)
        if candidate is None:
            return self._pages.wait(window, self._desk.answers)
        take = self._stage.take_of(candidate.key)
        if take is not None:
            return self._pages.show(window, take)
        return self._pages.ask(window, candidate, Said(), self._desk.answers, last)

    def _right(self, window: str, key: str, form: Form) -> str:
        return self._answered(window, self._desk.answer(key))

    def _wrong(self, window: str, key: str, form: Form) -> str:
        wrong_from, right_for = self._marked(key, form)
        return self._answered(window, self._desk.answer(key, wrong_from=wrong_from, right_for=right_for))

    def _skip(self, window: str, key: str, form: Form) -> str:
        self._desk.skip(key)
        return _address(window)

    def _show(self, window: str, key: str, form: Form) -> str:
        self._stage.start(self._desk.lent(key), *self._marked(key, form))
        return _address(window, episode=key)

    def _again(self, window: str, key: str, form: Form) -> str:
        if (take := self._stage.take_of(key)) is not None:
            self._stage.start(take.candidate, take.wrong_from, take.right_for)
        return _address(window, episode=key)

    def _keep(self, window: str, key: str, form: Form) -> str:
        take = self._stage.take_of(key)
        if take is None or take.shown is None:
            return _address(window, episode=key)
        answer = self._desk.answer(key, wrong_from=take.wrong_from, right_for=take.right_for, shown=take.shown)
        self._stage.drop(key)
        return self._answered(window, answer)

    def _drop(self, window: str, key: str, form: Form) -> str:
        self._stage.drop(key)
        return _address(window, episode=key)

    def _answered(self, window: str, answer: Answer) -> str:
        return _address(window, last=answer.file_name)

    def _marked(self, key: str, form: Form) -> tuple[int, str]:
        """The step from which on an episode is wrong, the last one unless one is marked; and the instruction typed."""
        steps, marked = len(self._desk.lent(key).trajectory), _step(form)
        return (marked or steps) - 1, form.get("right_for", "").strip()


def _step(form: Form) -> int:
    """The number of the marked step, from 1; 0 if none is."""
    text = form.get("step", "")
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 6 else 0


def _address(window: str, **more: str) -> str:
    return f"./?{urlencode({'window': window, **more})}"


def _html(text: str, status: int = 200) -> web.Response:
    """A page. JavaScript's lone surrogates, which UTF-8 does not have, are shown as question marks."""
    return web.Response(body=text.encode("utf-8", "replace"), status=status, content_type="text/html", charset="utf-8")
