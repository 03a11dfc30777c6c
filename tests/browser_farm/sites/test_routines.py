"""Routines that wait for each other's messages, dialogs as pages, the proxy that refuses."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import cast

import pytest

from browser_farm.chrome.answers import Failure
from browser_farm.chrome.devtools import DevTools
from browser_farm.sites.outside import OutsideError, run_command, run_request
from browser_farm.sites.page import Dialog
from browser_farm.sites.routines import Routine, TabFailed, Wait, run_all, sleep
from browser_farm.sites.servers import Refuser


class Messages:
    """Stands for a DevTools connection: each pump delivers one message."""

    def __init__(self) -> None:
        self.delivered = 0

    def pump(self, deadline: float) -> bool:
        self.delivered += 1
        return True


def test_routines_wait_at_the_same_time_and_return_their_results() -> None:
    messages = Messages()
    order: list[str] = []

    def routine(name: str, wanted: int) -> Routine[str]:
        assert (yield Wait(lambda: messages.delivered >= wanted, time.monotonic() + 60))
        order.append(name)
        return name.upper()

    results = run_all(cast(DevTools, messages), {0: routine("late", 5), 1: routine("soon", 2)})
    assert (results, order) == ({0: "LATE", 1: "SOON"}, ["soon", "late"])


def test_a_routine_that_fails_is_a_failure_and_the_others_go_on() -> None:
    def fails() -> Routine[str]:
        yield from sleep(0.0)
        raise TabFailed("page_hung", "no answer")

    def goes_on() -> Routine[str]:
        is_ready = yield Wait(lambda: False, time.monotonic())
        return f"ready {is_ready}"

    results = run_all(cast(DevTools, Messages()), {0: fails(), 1: goes_on()})
    assert results == {0: Failure(cause="page_hung", message="no answer"), 1: "ready False"}


def test_a_dialog_is_a_page_whose_rows_have_the_refs_after_those_of_the_page() -> None:
    dialog = Dialog("prompt", "Name?", "Ada")
    page = dialog.page(40)
    assert page.tag == ("dialog", "t", "input_text", "button", "button")
    assert page.ref.tolist() == [40, 41, 42, 43, 44]
    assert page.typable.tolist() == [False, False, True, False, False]
    assert dialog.row_of(44) == ("button", "Cancel", "")
    assert dialog.row_of(39) == ("", "", "")


def test_the_proxy_closes_connections_without_an_answer_and_counts_them() -> None:
    refuser = Refuser()
    host, port = refuser.address.split(":")
    for line in (b"GET http://foreign.test/x HTTP/1.1\r\n\r\n", b"CONNECT foreign.test:443 HTTP/1.1\r\n\r\n"):
        with socket.create_connection((host, int(port)), timeout=5) as client:
            client.sendall(line)
            assert client.recv(100) == b""
    refuser.close()
    assert refuser.refused == {"foreign.test": 1, "foreign.test:443": 1}


def test_programs_and_requests_of_a_task_file_fail_with_one_line(tmp_path: Path) -> None:
    assert run_command(["sh", "-c", 'test "$GIIRL_NAME" = Ada'], tmp_path, {"name": "Ada"}, 10) == 0
    assert run_command(["false"], tmp_path, {}, 10) == 1
    with pytest.raises(OutsideError, match="cannot run no-such-program: No such file"):
        run_command(["no-such-program"], tmp_path, {}, 10)
    with pytest.raises(OutsideError, match="ended with status 3: broken"):
        run_command(["sh", "-c", "echo broken >&2; exit 3"], tmp_path, {}, 10)
    with pytest.raises(OutsideError, match=r"sleep did not end in 0\.05 s"):
        run_command(["sleep", "5"], tmp_path, {}, 0.05)
    with pytest.raises(OutsideError, match=r"POST http://127\.0\.0\.1:4319/ failed: "):
        run_request("POST", "http://127.0.0.1:4319/", 5)
