"""The HTTP API of the learned reward: its answers, its errors, and who may ask."""

from __future__ import annotations

import http.client
import json
import random
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from giirl_core.config_file import load_config
from giirl_core.gestures import read_gestures
from giirl_core.metrics import Metrics
from giirl_core.nets.reward import RewardModel, build_reward
from giirl_core.processes import request_body
from giirl_core.telemetry.prometheus import parse_samples
from giirl_core.telemetry.series import SERVICE
from giirl_core.types import Action, Goal, Verb
from reward_service import http_api
from reward_service.http_schema import ScoreRequest
from tests.reward_service.mutations import DEADLINE_S, REQUEST, exchange, mutated

TOKEN = "0123456789abcdef"
WAIT_S = 20.0


@pytest.fixture(scope="module")
def reward() -> RewardModel:
    """An untrained reward."""
    return build_reward(load_config(None, ["net.vectors=hashed"]))


@contextmanager
def serving(reward: RewardModel, **options: Any) -> Iterator[str]:
    """The address of a server in a thread."""
    server = http_api.open_server(reward, Metrics(SERVICE), **options)
    stop, ready = threading.Event(), threading.Event()
    thread = threading.Thread(target=server.serve, args=(stop, lambda address: ready.set()))
    thread.start()
    try:
        assert ready.wait(WAIT_S)
        yield server.address
    finally:
        stop.set()
        thread.join(WAIT_S)
        assert not thread.is_alive()


@pytest.fixture(scope="module")
def address(reward: RewardModel) -> Iterator[str]:
    with serving(reward) as address:
        yield address


def ask(address: str, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, str]:
    """Status and text of the answer."""
    connection = http.client.HTTPConnection(address.removeprefix("http://"), timeout=DEADLINE_S)
    sent = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
    try:
        connection.request(method, path, sent, {"Content-Type": "application/json", **headers})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


def error_of(status: int, text: str) -> str:
    """The line of an answer that is an error."""
    assert 400 <= status < 500, (status, text)
    [(key, line)] = json.loads(text).items()
    assert key == "error"
    assert line == " ".join(line.split())
    assert line.isascii()
    return str(line)


def changed(part: str, index: int | None = None, **values: Any) -> dict[str, Any]:
    """The request with other values: of the request itself, or of one element or action."""
    if index is None:
        return {**REQUEST, part: values["to"]}
    rows = [{**row, **values} if at == index else row for at, row in enumerate(REQUEST[part])]
    return {**REQUEST, part: rows}


def test_the_rewards_are_those_of_the_model_and_the_best_is_first(address: str, reward: RewardModel) -> None:
    status, text = ask(address, "POST", "/score", REQUEST)
    assert status == 200
    answer = json.loads(text)
    goal = Goal(REQUEST["goal"])
    page, _, _ = ScoreRequest.model_validate(REQUEST).read()
    assert page.text[2:4] == ("Ok", "16/12/2021")
    assert page.parent.tolist() == [-1, 0, 0, 0, -1]
    assert page.box[2].tolist() == [2, 90.5, 40, 21]
    actions = [Action(verb=Verb.CLICK, element=2), Action(verb=Verb.CLICK, element=3)]
    actions.append(Action(verb=Verb.TYPE, element=1, start=2, end=2))
    rewards = reward.score_actions(page, goal, actions).tolist()
    assert answer["rewards"] == pytest.approx(rewards, abs=1e-5)
    assert len(set(rewards)) == 3
    assert answer["best_first"] == sorted(range(3), key=lambda index: -rewards[index])
    assert (answer["version"], answer["form"]) == (-1, "logit")


def test_the_request_for_a_page_is_read_as_that_page() -> None:
    request = ScoreRequest.model_validate(REQUEST)
    again = ScoreRequest.model_validate_json(ScoreRequest.of(*request.read()).model_dump_json(exclude_defaults=True))
    assert again == request
    with pytest.raises(ValueError, match="is not in this API: wanted an action on an element"):
        ScoreRequest.of(*request.read()[:2], [Action(verb=Verb.PRESS, literal="Enter")])


def test_gestures_of_the_reward_are_read_as_actions() -> None:
    gestures = read_gestures(["hover", "press Enter", "drag to", "type text-of"])
    page, goal, _ = ScoreRequest.model_validate(REQUEST).read()
    actions = [
        Action(verb=Verb.HOVER, element=2),
        Action(verb=Verb.PRESS, element=1, literal="Enter"),
        Action(verb=Verb.DRAG, element=2, to=3),
        Action(verb=Verb.TYPE, element=1, literal=page.text[3]),
    ]
    body = ScoreRequest.of(page, goal, actions).model_dump_json(exclude_defaults=True)
    assert ScoreRequest.model_validate_json(body).read(gestures)[2] == actions


@pytest.mark.parametrize(
    ("body", "line"),
    [
        (changed("goal", to=" "), "goal: wanted at least one word, got ' '"),
        (changed("elements", to=[]), "elements: tuple should have at least 1 item after validation, not 0, got []"),
        (changed("elements", 2, parent=2), "elements.2.parent: wanted the index of an earlier element, or -1, got 2"),
        (changed("elements", 1, left="2"), "elements.1.left: input should be a valid number, got '2'"),
        (changed("elements", 1, id=7), "elements.1.id: extra inputs are not permitted, got 7"),
        (changed("actions", 0, element=5), "actions.0.element: wanted one of the 5 elements, from 0, got 5"),
        (
            {**REQUEST, "actions": [{"verb": "gesture", "gesture": "hover", "element": 0}]},
            "actions.0.gesture: wanted one of click, got 'hover'",
        ),
        (
            {**REQUEST, "actions": [{"verb": "gesture", "gesture": "click", "element": 0, "second": 1}]},
            "actions.0.second: wanted none for click, got 1",
        ),
        (changed("actions", 2, text="Bob"), "actions.2.text: wanted words of the goal, got 'Bob'"),
        (changed("actions", 2, text="\ud800\n"), "actions.2.text: input should be a valid string, unable to parse raw"),
        (changed("actions", 0, verb="drag"), "actions.0: input tag 'drag' found using 'verb' does not match any of"),
        (b'{"goal": x}', "the body: wanted JSON, got an error at character 9: Expecting value"),
        (b"[" * 100_000, "the body: wanted JSON, got something else"),
        (b"x" * (request_body.MAX_BYTES + 1), "the body: wanted at most 1048576 bytes, got more"),
        (b"", "the body: field required"),
    ],
)
def test_a_wrong_request_is_answered_with_one_line_that_says_where_what_and_why(
    address: str, body: Any, line: str
) -> None:
    assert error_of(*ask(address, "POST", "/score", body)).startswith(line)


def test_a_wrong_path_and_a_wrong_method_are_answered_with_one_line(address: str) -> None:
    assert error_of(*ask(address, "GET", "/nothing")) == (
        "the path: wanted /score, /healthz, /readyz, /metrics or /docs, got /nothing"
    )
    assert error_of(*ask(address, "GET", "/score")) == "the method of /score: wanted POST, got GET"


def test_the_api_describes_itself_without_another_host(address: str) -> None:
    status, text = ask(address, "GET", "/openapi.json")
    described = json.loads(text)
    assert status == 200
    assert set(described["paths"]) == {"/score", "/metrics", "/healthz", "/readyz"}
    assert set(described["paths"]["/score"]["post"]["responses"]) >= {"200", "401", "413", "422"}
    status, page = ask(address, "GET", "/docs")
    assert status == 200
    assert "https://" not in page
    assert ask(address, "GET", "/static-offline-docs/swagger-ui-bundle.js")[0] == 200


def test_health_and_metrics_are_served(reward: RewardModel) -> None:
    with serving(reward) as address:
        assert ask(address, "GET", "/healthz") == ask(address, "GET", "/readyz") == (200, "ok\n")
        ask(address, "POST", "/score", REQUEST)
        ask(address, "POST", "/score", b"{")
        status, text = ask(address, "GET", "/metrics")
    samples = parse_samples(text)
    counts = {labels["result"]: value for labels, value in samples["giirl_scoring_requests_total"]}
    assert status == 200
    assert (counts["ok"], counts["malformed"]) == (1, 1)
    assert samples["giirl_scoring_duration_seconds_count"] == [({}, 1)]


def test_while_requests_wait_for_the_nets_health_and_errors_are_answered(
    reward: RewardModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def slow(*_: Any) -> Any:
        begun.set()
        assert go_on.wait(WAIT_S)
        raise RuntimeError("no\nnets")

    monkeypatch.setattr(reward, "score_actions", slow)
    monkeypatch.setattr(http_api, "WAIT_S", 0.1)
    answers: list[tuple[int, str]] = []
    with serving(reward) as address:
        first = threading.Thread(target=lambda: answers.append(ask(address, "POST", "/score", REQUEST)))
        first.start()
        assert begun.wait(WAIT_S)
        status, text = ask(address, "POST", "/score", REQUEST)
        assert (status, json.loads(text)["error"][:44]) == (503, "the service: wanted fewer requests at once, ")
        assert ask(address, "GET", "/healthz")[0] == 200
        assert ask(address, "POST", "/score", b"{")[0] == 422
        go_on.set()
        first.join(WAIT_S)
        samples = parse_samples(ask(address, "GET", "/metrics")[1])
    counts = {labels["result"]: value for labels, value in samples["giirl_scoring_requests_total"]}
    assert answers == [(500, '{"error":"scoring failed: RuntimeError: no nets"}')]
    assert (counts["failed"], counts["overloaded"], counts["malformed"], counts["ok"]) == (1, 1, 1, 0)


def test_with_a_token_only_its_holder_gets_rewards_and_metrics(reward: RewardModel) -> None:
    with serving(reward, token=TOKEN) as address:
        for method, path, body in (("POST", "/score", REQUEST), ("GET", "/metrics", None)):
            refused = {"none": {}, "another": {"Authorization": f"Bearer {TOKEN}x"}}
            for got, headers in refused.items():
                status, text = ask(address, method, path, body, **headers)
                assert status == 401
                assert error_of(status, text) == f"the header Authorization: wanted Bearer and the token, got {got}"
            assert ask(address, method, path, body, Authorization=f"Bearer {TOKEN}")[0] == 200
        assert ask(address, "GET", "/healthz")[0] == 200


@pytest.mark.parametrize(
    ("host", "token", "line"),
    [
        ("0.0.0.0", "", "cannot listen on 0.0.0.0 without a token: wanted a loopback address, or a token"),
        ("127.0.0.1", "short", "the token has 5 characters: wanted 16 or more, ASCII, no spaces"),
        ("0.0.0.0", "with a space inside", "the token has 19 characters: wanted 16 or more, ASCII, no spaces"),
        ("no.such.host.invalid", TOKEN, "cannot listen on no.such.host.invalid:0: "),
    ],
)
def test_an_address_beyond_loopback_needs_a_token(reward: RewardModel, host: str, token: str, line: str) -> None:
    with pytest.raises(ValueError, match=line.replace(".", r"\.")):
        http_api.open_server(reward, Metrics(SERVICE), host=host, token=token)


def test_a_port_in_use_is_one_line(reward: RewardModel, address: str) -> None:
    port = int(address.rpartition(":")[2])
    with pytest.raises(ValueError, match=f"cannot listen on 127.0.0.1:{port}: .*; wanted a free port, or 0"):
        http_api.open_server(reward, Metrics(SERVICE), port=port)


def test_a_body_that_never_ends_is_answered_at_the_deadline(
    reward: RewardModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(request_body, "READ_S", 0.3)
    with serving(reward) as address:
        host, _, port = address.removeprefix("http://").rpartition(":")
        with socket.create_connection((host, int(port)), timeout=DEADLINE_S) as connection:
            connection.sendall(b"POST /score HTTP/1.1\r\nhost: x\r\ncontent-length: 100\r\n\r\n{")
            assert connection.recv(1 << 16).startswith(b"HTTP/1.1 408 ")


@pytest.mark.parametrize("count", [400, pytest.param(10_000, marks=pytest.mark.slow)])
def test_mutated_requests_are_scored_or_refused_in_one_line(address: str, count: int) -> None:
    rng = random.Random(count)
    statuses: dict[int, int] = {}
    for _ in range(count):
        request = mutated(rng)
        status, body = exchange(address, request)
        assert status == 0 or status < 500, (status, request[:3000], body)
        if body.startswith(b"{") and status >= 400:
            error_of(status, body.decode())
        statuses[status] = statuses.get(status, 0) + 1
    assert statuses[422] > count / 2
    assert statuses[200] > count / 100
    assert statuses.get(0, 0) < count / 20
    assert ask(address, "POST", "/score", REQUEST)[0] == 200
