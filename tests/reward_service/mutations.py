"""Requests to the HTTP API, and what may go wrong with them: other bytes, other values, other heads."""

from __future__ import annotations

import copy
import json
import random
import socket
from typing import Any

REQUEST: dict[str, Any] = {
    "goal": 'Enter "Ada" into the text field and press Ok.',
    "elements": [
        {"tag": "div", "left": 0, "top": 50, "width": 160, "height": 160, "classes": "form wide"},
        {"tag": "input_text", "parent": 0, "left": 2, "top": 60, "width": 128, "height": 21, "attributes": "tt name"},
        {
            "tag": "button",
            "parent": 0,
            "left": 2,
            "top": 90.5,
            "width": 40,
            "height": 21,
            "text": "Ok",
            "focused": True,
        },
        {"tag": "t", "parent": 0, "left": 2, "top": 120, "width": 40, "height": 11, "text": "16/12/2021"},
        {"tag": "circle", "left": 80, "top": 90, "width": 9, "height": 9, "colour": "#ff0000", "shape": "circle"},
    ],
    "actions": [
        {"verb": "click", "element": 2},
        {"verb": "click", "element": 3},
        {"verb": "type", "element": 1, "text": "Ada"},
    ],
}
ODD_VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3, 499, 500, 2**31, 2**63, 10**400, 0.5, -0.0, 1e308, 5e-324),
    *(
        float("nan"),
        float("inf"),
        "",
        " ",
        "\x00",
        "\ud800",
        "\udfff" * 99,
        "ß" * 4999,
        "9" * 9000,
        "Ada",
        '"',
        "\n" * 9,
    ),
    *(
        "rgb(9,9,9)",
        f"rgb({'9' * 400}, 1, 1)",
        "#ff000",
        "triangle",
        " 1,2 3",
        "input_text",
        "select",
        "²",
        "٣",
        "March",
    ),
    *([], {}, [[]], [None] * 5, [{}] * 501, {"verb": "click"}, {"element": 1}, {"tag": "a"}, {"": ""}),
)
ODD_BYTES = (b"[" * 5000, b"{" * 5000, b'"', b"\\ud800", b",", b"1e999", b"\x00")
HEADS = (
    b"content-type: text/plain",
    b"content-type: application/json; charset=utf-16",
    b"content-encoding: gzip",
    b"expect: 200-ok",
    b"upgrade: websocket",
    b"authorization: Bearer \xff",
    b"x: " + b"y" * 70_000,
)
PATHS = (b"/", b"/score/", b"//score", b"/score?x=%ff", b"/%00", b"*", b"http://x/score", b"/static-offline-docs/../x")
DEADLINE_S = 15.0


def mutated(rng: random.Random) -> bytes:
    """An HTTP request that differs from a good one in one to three ways."""
    request, body, path, head = copy.deepcopy(REQUEST), None, b"/score", [b"content-type: application/json"]
    method = b"POST"
    for _ in range(rng.randint(1, 3)):
        match rng.randrange(10):
            case 0 | 1 | 2 | 3 | 4 | 5:
                _change_a_value(request, rng)
            case 6 | 7:
                body = _with_other_bytes(body or json.dumps(request).encode(), rng)
            case 8:
                head = [rng.choice(HEADS)]
            case 9:
                path, method = rng.choice(PATHS), rng.choice((b"GET", b"PUT", b"POST", b"HEAD", b"X", b"\xff"))
    sent = json.dumps(request).encode() if body is None else body
    length = b"content-length: %d" % len(sent)
    if rng.random() < 0.05:
        length, sent = b"transfer-encoding: chunked", b"%x\r\n%b\r\n0\r\n\r\n" % (len(sent), sent)
    lines = [method + b" " + path + b" HTTP/1.1", b"host: x", b"connection: close", *head, length, b"", sent]
    return b"\r\n".join(lines)


def exchange(address: str, request: bytes) -> tuple[int, bytes]:
    """Status and body of the answer; status 0 from a server that closes the connection without one."""
    host, _, port = address.removeprefix("http://").rpartition(":")
    with socket.create_connection((host, int(port)), timeout=DEADLINE_S) as connection:
        connection.sendall(request)
        answer = b""
        while part := connection.recv(1 << 16):
            answer += part
    head, _, body = answer.partition(b"\r\n\r\n")
    return int(head.split()[1]) if head else 0, body


def _change_a_value(request: Any, rng: random.Random) -> None:
    """Put an odd value in the place of another, leave one out, or add one."""
    value = request
    while True:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        if not keys:
            return
        key = rng.choice(keys)
        if not isinstance(value[key], dict | list) or rng.random() < 0.15:
            break
        value = value[key]
    kind = rng.randrange(5)
    if kind == 0:
        del value[key]
    elif kind == 1 and isinstance(value, dict):
        value[rng.choice(("x", "", "\ud800", "element", "text", "body"))] = rng.choice(ODD_VALUES)
    else:
        value[key] = rng.choice(ODD_VALUES)


def _with_other_bytes(body: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(body) + 1)
    match rng.randrange(4):
        case 0:
            return body[:at]
        case 1:
            return body[:at] + rng.randbytes(3) + body[at:]
        case 2:
            return (
                body[:at]
                + rng.choice((b"[" * 5000, b"{" * 5000, b'"', b"\\ud800", b",", b"1e999", b"\x00"))
                + body[at:]
            )
        case _:
            return body[:at] + body[at + rng.randrange(9) :]
