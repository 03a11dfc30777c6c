"""How often an actor sends notices. Delivery over real sockets is tested in tests/learner/test_stream.py."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from actors.episode_counter import EpisodeCounter
from actors.uplink import Uplink, UplinkLimits
from giirl_core.wire import delivery
from giirl_core.wire.delivery import Grant


class FakeClock:
    """A clock that only the test advances."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


class FakeDealer:
    """A connection that records the times at which messages are sent."""

    def __init__(self, clock: FakeClock) -> None:
        self.connected, self.sent_s, self.replies = True, list[float](), list[bytes]()
        self._clock = clock

    def send(self, message: bytes) -> bool:
        if self.connected:
            self.sent_s.append(self._clock.now_s)
        return self.connected

    def recv(self, timeout_s: float) -> bytes | None:
        return self.replies.pop() if self.replies else None


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> FakeClock:
    fake = FakeClock()
    monkeypatch.setattr("actors.uplink.time", fake)
    return fake


@pytest.fixture
def dealer(clock: FakeClock, monkeypatch: pytest.MonkeyPatch) -> FakeDealer:
    fake = FakeDealer(clock)

    def connect(address: str, **_: Any) -> FakeDealer:
        return fake

    monkeypatch.setattr("actors.uplink.Dealer", connect)
    return fake


@pytest.fixture
def uplink(dealer: FakeDealer, tmp_path: Path) -> Uplink:
    counter, limits = EpisodeCounter(tmp_path / "a", 0), UplinkLimits(heartbeat_s=1.0, hello_s=1.0)
    return Uplink("learner", run="run", actor="a", incarnation=0, counter=counter, limits=limits)


def intervals(uplink: Uplink, dealer: FakeDealer, clock: FakeClock, notices: int) -> list[float]:
    """The seconds between the next notices."""
    dealer.sent_s.clear()
    while len(dealer.sent_s) < notices:
        uplink.poll()
        clock.now_s += 0.5
    return [after - before for before, after in pairwise(dealer.sent_s)]


def test_notices_become_rare_while_the_learner_does_not_answer(
    uplink: Uplink, dealer: FakeDealer, clock: FakeClock
) -> None:
    assert intervals(uplink, dealer, clock, 7) == [1, 2, 4, 8, 8, 8]
    grant = Grant(incarnation=0, notice=7, low_watermark=0, committed=0, settled=0, limit=1)
    dealer.replies.append(delivery.encode_grant(grant))
    assert intervals(uplink, dealer, clock, 4) == [1, 2, 4]


def test_notices_are_frequent_again_after_the_connection_was_lost(
    uplink: Uplink, dealer: FakeDealer, clock: FakeClock
) -> None:
    assert intervals(uplink, dealer, clock, 5) == [1, 2, 4, 8]
    dealer.connected = False
    for _ in range(20):
        uplink.poll()
        clock.now_s += 1.0
    dealer.connected = True
    assert intervals(uplink, dealer, clock, 3) == [1, 2]
