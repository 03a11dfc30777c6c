"""The HTTP API of the learned reward: rewards of candidate actions, health, metrics, and an OpenAPI page."""

from __future__ import annotations

import hmac
from collections.abc import Callable, Sequence
from threading import Lock
from typing import Annotated, Any

import numpy as np
from fastapi import Depends, FastAPI, HTTPException, Request, Response, Security
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, PlainTextResponse
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer
from fastapi_offline import FastAPIOffline
from starlette.exceptions import HTTPException as AnyHTTPException

from giirl_core.metrics import Metrics
from giirl_core.nets.reward import RewardModel
from giirl_core.processes.web_server import WebServer
from giirl_core.wire.addresses import is_loopback
from reward_service.http_schema import Problem, ScoreRequest, Scores, one_line, shown

WAIT_S = 10.0  # longest wait of a request for those before it
TOKEN_CHARACTERS = 16  # the least of a token
TITLE = "The learned reward of GIIRL"
BEARER = HTTPBearer(auto_error=False, description="The token with which the service was started.")
RESULTS = {
    400: "malformed",
    422: "malformed",
    500: "failed",
    503: "overloaded",
}  # HTTP status -> result in the metrics; 200 is "ok"
REFUSALS: dict[int | str, dict[str, Any]] = {
    400: {"model": Problem, "description": "The body is no JSON."},
    401: {"model": Problem, "description": "There is no token, or a wrong one."},
    413: {"model": Problem, "description": "The body is too large."},
    422: {"model": Problem, "description": "The request is wrong."},
    503: {"model": Problem, "description": "Too many requests wait."},
}


def open_server(
    reward: RewardModel, metrics: Metrics, *, host: str = "127.0.0.1", port: int = 0, token: str = ""
) -> WebServer:
    """A server of one reward, which listens. Port 0 takes any free one.

    ValueError where it cannot listen, beyond loopback without a token, and for a token that is easy to guess.
    """
    if not token and not is_loopback(host):
        raise ValueError(f"cannot listen on {host} without a token: wanted a loopback address, or a token")
    if token and (len(token) < TOKEN_CHARACTERS or not token.isascii() or not token.isprintable() or " " in token):
        raise ValueError(f"the token has {len(token)} characters: wanted {TOKEN_CHARACTERS} or more, ASCII, no spaces")
    return WebServer(build_app(reward, metrics, token), host=host, port=port)


def build_app(reward: RewardModel, metrics: Metrics, token: str = "") -> FastAPI:
    """The application for one reward. With a token, scores and metrics are for those who send it."""
    app = FastAPIOffline(title=TITLE, version=str(reward.version), redoc_url=None, redirect_slashes=False)
    guards = [Depends(_guard(token))] if token else []
    scoring = Lock()  # the nets use one thread; requests wait in threads of their own, so that others are answered

    @app.post("/score", responses=REFUSALS, dependencies=guards)
    def score(request: ScoreRequest) -> Scores:
        """The reward of each candidate action on a page under a goal, and their order from the best to the worst."""
        with metrics.scoring_duration.time():
            try:
                page, goal, actions = request.read(reward.net.gestures)
            except ValueError as error:
                raise HTTPException(422, str(error)) from None
            if not scoring.acquire(timeout=WAIT_S):
                raise HTTPException(503, f"the service: wanted fewer requests at once, this one waited {WAIT_S:.0f} s")
            try:
                rewards = reward.score_actions(page, goal, actions)
            finally:
                scoring.release()
        metrics.scoring_requests.labels("ok").inc()
        order = np.argsort(-rewards, kind="stable")
        return Scores(rewards=rewards.tolist(), best_first=order.tolist(), version=reward.version, form=reward.form)

    @app.get("/metrics", response_class=PlainTextResponse, dependencies=guards)
    async def prometheus(request: Request) -> Response:
        """Metrics for Prometheus."""
        body, content_type = metrics.render(request.headers.get("accept", ""))
        return Response(body, headers={"Content-Type": content_type})

    @app.get("/healthz", response_class=PlainTextResponse)
    async def healthz() -> Response:
        """Whether the process is alive."""
        return _probe(metrics.health.hung)

    @app.get("/readyz", response_class=PlainTextResponse)
    async def readyz() -> Response:
        """Whether the process serves."""
        return _probe(metrics.health.unready)

    _answer_errors_in_one_line(app, metrics)
    metrics.reward_version.set(reward.version)
    metrics.health.ready()
    return app


def _guard(token: str) -> Callable[[HTTPAuthorizationCredentials | None], None]:
    def check(sent: Annotated[HTTPAuthorizationCredentials | None, Security(BEARER)]) -> None:
        if sent is None or not hmac.compare_digest(sent.credentials.encode(), token.encode()):
            got = "none" if sent is None else "another"
            raise HTTPException(
                401, f"the header Authorization: wanted Bearer and the token, got {got}", {"WWW-Authenticate": "Bearer"}
            )

    return check


def _probe(problem: str) -> Response:
    return PlainTextResponse(f"{problem or 'ok'}\n", status_code=503 if problem else 200)


def _answer_errors_in_one_line(app: FastAPI, metrics: Metrics) -> None:
    def answer(status: int, line: str, headers: Any = None) -> Response:
        if status in RESULTS:
            metrics.scoring_requests.labels(RESULTS[status]).inc()
        return JSONResponse({"error": one_line(line)}, status, headers)

    async def refused(request: Request, error: Exception) -> Response:
        assert isinstance(error, RequestValidationError)
        return answer(422, _line(error.errors()))

    async def failed(request: Request, error: Exception) -> Response:
        return answer(500, f"scoring failed: {type(error).__name__}: {error}")

    async def problem(request: Request, error: Exception) -> Response:
        assert isinstance(error, AnyHTTPException)
        unread = error.status_code == 400  # what json cannot read although it may be JSON, such as 1e5 brackets
        line = "the body: wanted JSON, got something else" if unread else str(error.detail)
        return answer(error.status_code, line, error.headers)

    async def missing(request: Request, error: Exception) -> Response:
        return answer(404, f"the path: wanted /score, /healthz, /readyz, /metrics or /docs, got {request.url.path}")

    async def other_method(request: Request, error: Exception) -> Response:
        headers = getattr(error, "headers", None) or {}
        wanted = headers.get("Allow", "another")
        return answer(405, f"the method of {request.url.path}: wanted {wanted}, got {request.method}", headers)

    app.add_exception_handler(RequestValidationError, refused)
    app.add_exception_handler(AnyHTTPException, problem)
    app.add_exception_handler(404, missing)
    app.add_exception_handler(405, other_method)
    app.add_exception_handler(Exception, failed)


def _line(errors: Sequence[Any]) -> str:
    """What is wrong first, where, what was wanted and what was got."""
    first = errors[0]
    if first["type"] == "json_invalid":
        return f"the body: wanted JSON, got an error at character {first['loc'][-1]}: {first['ctx']['error']}"
    names = [str(part) for part in first["loc"] if part not in ("body", "click", "type")]
    wanted = first["msg"][:1].lower() + first["msg"][1:]
    got = "" if first["type"] == "missing" else f", got {shown(first['input'])}"
    more = f"; {len(errors) - 1} more" if len(errors) > 1 else ""
    return f"{'.'.join(names) or 'the body'}: {wanted}{got}{more}"
