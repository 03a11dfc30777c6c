"""The pages of `giirl feedback` over HTTP, on loopback: hands them out and takes answers. All else is in `Desk`."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from threading import Event
from urllib.parse import parse_qsl, urlencode

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from giirl.feedback.desk import Desk
from giirl.feedback.page import Pages, Said
from giirl.feedback.stage import Stage
from giirl_core.files import explain
from giirl_core.processes.web_server import WebServer
from giirl_core.wire.answers import Answer

KEYS_JS = Path(__file__).with_name("keys.js")
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
Form = Mapping[str, str]


class FeedbackServer:
    """Answers requests for `/TOKEN/...`. The token keeps other users of the machine out.

    A page is for one window, which names itself in its address: two windows never show the same episode. It listens
    from the start, and answers while `serve` runs. ValueError if it cannot listen on the port; 0 takes any free one.
    """

    def __init__(self, desk: Desk, stage: Stage, pages: Pages, port: int = 0) -> None:
        self._desk, self._stage, self._pages = desk, stage, pages
        self._token = secrets.token_urlsafe(16)
        self._verbs: dict[str, Callable[[str, str, Form], str]] = {
            "right": self._right,
            "wrong": self._wrong,
            "skip": self._skip,
            "show": self._show,
            "keep": self._keep,
            "again": self._again,
            "drop": self._drop,
        }
        routes = [
            Route("/{token}/", self._get),
            Route("/{token}/keys.js", self._keys),
            Route("/{token}/{verb}", self._post, methods=["POST"]),
        ]
        self._server = WebServer(Starlette(routes=routes), port=port)
        self.address = f"{self._server.address}/{self._token}/"

    def serve(self, stop: Event, on_ready: Callable[[str], None]) -> None:
        """Serve until `stop`; `on_ready` is called with the address."""
        self._server.serve(stop, lambda _: on_ready(self.address))

    def close(self) -> None:
        """Listen no longer; for a server that never serves."""
        self._server.close()

    def _refused(self, request: Request) -> Response | None:
        """404 for everything without the token."""
        if hmac.compare_digest(request.path_params["token"].encode(), self._token.encode()):
            return None
        return PlainTextResponse("not found: wanted the address that giirl feedback printed\n", 404)

    def _keys(self, request: Request) -> Response:
        script = Response(KEYS_JS.read_bytes(), media_type="text/javascript", headers=HEADERS)
        return self._refused(request) or script

    def _get(self, request: Request) -> Response:
        if refused := self._refused(request):
            return refused
        window = request.query_params.get("window", "")
        if not window:
            return _see(f"?{urlencode({'window': secrets.token_hex(4)})}")
        try:
            asked = (request.query_params.get(name, "") for name in ("episode", "last"))
            return _html(self._state(window, *asked))
        except LookupError:
            return _see(_address(window))

    async def _post(self, request: Request) -> Response:
        """Do what a form asks for; then the window gets its next page, or the same page with what is wrong."""
        if refused := self._refused(request):
            return refused
        form = dict(parse_qsl((await request.body()).decode("utf-8", "replace")))
        return await run_in_threadpool(self._act, request.path_params["verb"], form)

    def _act(self, name: str, form: Form) -> Response:
        verb, window, key = self._verbs.get(name), form.get("window", ""), form.get("key", "")
        if verb is None or not window:
            return PlainTextResponse(f"wanted one of {', '.join(self._verbs)}, with a window and a key\n", 400)
        try:
            return _see(verb(window, key, form))
        except LookupError:  # of an earlier server; the page is played again
            return _see(_address(window))
        except (ValueError, OSError) as error:  # OSError: nothing was written
            said = Said(step=_step(form), right_for=form.get("right_for", ""), error=explain(error))
            page = self._pages.ask(window, self._desk.lent(key), said, self._desk.answers, "")
            return _html(page, status=422 if isinstance(error, ValueError) else 500)

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


def _see(address: str) -> Response:
    return RedirectResponse(address, 303, HEADERS)


def _html(text: str, status: int = 200) -> Response:
    """A page. JavaScript's lone surrogates, which UTF-8 does not have, are shown as question marks."""
    return Response(text.encode("utf-8", "replace"), status, HEADERS, "text/html; charset=utf-8")
