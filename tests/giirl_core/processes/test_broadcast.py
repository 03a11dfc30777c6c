"""Weights for many processes: each gets the newest, and who sends them does not wait."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import pytest

from giirl_core.processes import shared_requests
from giirl_core.processes.broadcast import Broadcast
from giirl_core.processes.shared_requests import UnfinishedCalls
from tests.reward_service.serving import WAIT_S, until


class SlowCall:
    def __init__(self) -> None:
        self.finished = False

    def done(self) -> bool:
        return self.finished

    def result(self, timeout_s: float) -> Any:
        raise NotImplementedError


class LoadingProcess:
    """A process whose `load` returns when the test says so."""

    reattached = False

    def __init__(self) -> None:
        self.loaded: list[Any] = []
        self.calls: list[SlowCall] = []

    def placed(self) -> bool:
        return True

    def call(self, method: str, *values: Any) -> SlowCall:
        assert method == "load"
        self.loaded += values
        self.calls.append(SlowCall())
        return self.calls[-1]

    def kill(self) -> None:
        return


@pytest.fixture
def broadcast() -> Iterator[Broadcast]:
    with closing(Broadcast()) as made:
        yield made


def test_a_process_that_still_loads_weights_gets_only_the_newest_afterwards(broadcast: Broadcast) -> None:
    fast, slow = LoadingProcess(), LoadingProcess()
    for version in range(5):
        broadcast.send(version, [fast, slow])
        until(lambda version=version: fast.loaded[-1:] == [version])  # type: ignore[misc]
        fast.calls[-1].finished = True
    assert (fast.loaded, slow.loaded) == ([0, 1, 2, 3, 4], [0])
    slow.calls[-1].finished = True
    until(lambda: slow.loaded == [0, 4])


def test_sending_does_not_wait_for_a_call_that_blocks_and_none_is_passed_over_for_ever(broadcast: Broadcast) -> None:
    entered, release = threading.Event(), threading.Event()

    class BlockingProcess(LoadingProcess):
        def call(self, method: str, *values: Any) -> SlowCall:
            entered.set()
            assert release.wait(WAIT_S)
            call = super().call(method, *values)
            call.finished = True
            return call

    first, last = BlockingProcess(), LoadingProcess()
    broadcast.send(1, [first, last])
    assert entered.wait(WAIT_S)
    broadcast.send(2, [first, last])  # returns while the call blocks
    assert last.loaded == []
    release.set()
    until(lambda: last.loaded == [2] and first.loaded == [1, 2])


def test_a_process_that_has_left_gets_no_more_weights(broadcast: Broadcast) -> None:
    stays, leaves = LoadingProcess(), LoadingProcess()
    broadcast.send(1, [stays, leaves])
    until(lambda: stays.loaded == leaves.loaded == [1])
    broadcast.send(2, [stays])
    stays.calls[-1].finished = leaves.calls[-1].finished = True
    until(lambda: stays.loaded == [1, 2])
    assert leaves.loaded == [1]


def test_weights_that_cannot_be_sent_are_an_error_of_the_learner(broadcast: Broadcast) -> None:
    class BrokenProcess(LoadingProcess):
        def call(self, method: str, *values: Any) -> SlowCall:
            raise OSError("the cluster is gone")

    broadcast.send(1, [BrokenProcess()])
    until(lambda: not broadcast._thread.is_alive())
    with pytest.raises(RuntimeError, match="weights cannot be sent any more: OSError"):
        broadcast.send(2, [])


@dataclass(slots=True, weakref_slot=True, eq=False)
class NumberedCall:
    ref: int


def test_one_request_tells_of_all_calls_which_have_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    requests: list[list[int]] = []

    def odd(refs: list[int]) -> list[int]:
        requests.append(refs)
        return [ref for ref in refs if ref % 2]

    monkeypatch.setattr(shared_requests, "DONE_POLL_S", 3600.0)
    unfinished = UnfinishedCalls(odd)
    calls = [NumberedCall(ref) for ref in range(1000)]
    for call in calls:
        unfinished.add(call)
    assert [unfinished.is_done(call) for call in calls] == [bool(ref % 2) for ref in range(1000)]
    assert len(requests) == 1
    monkeypatch.setattr(shared_requests, "DONE_POLL_S", -1.0)
    del calls[100:], call
    assert not unfinished.is_done(calls[0])
    assert len(requests[1]) == 50  # neither those that returned nor those that nobody asks for
