"""Scoring requests and replies as bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl_core.types import Trajectory
from giirl_core.wire import messages as wire
from giirl_core.wire import scoring
from giirl_core.wire.messages import WireError
from giirl_core.wire.scoring import ScoreReply
from tests.giirl_core.wire_examples import NUMBER, assert_same_trajectory, episode, trajectories


@given(st.integers(0, 2**63), st.lists(trajectories(), min_size=1, max_size=3))
def test_a_request_survives_a_round_trip(number: int, sent: list[Trajectory]) -> None:
    header, arrays = wire.decode(scoring.encode_request(number, sent))
    assert scoring.read_request(header) == number
    for found, wanted in zip(scoring.build_request(header, arrays), sent, strict=True):
        assert_same_trajectory(found, wanted)


@given(st.lists(st.lists(NUMBER, max_size=4), max_size=4), st.integers(-1, 10**9), st.text(max_size=9))
def test_a_reply_survives_a_round_trip(rewards: list[list[float]], version: int, error: str) -> None:
    parts = tuple(np.array(part, np.float32) for part in rewards)
    sent = ScoreReply(request=3, rewards=parts, version=version, error=error)
    found = scoring.decode_reply(scoring.encode_reply(sent))
    assert (found.request, found.version, found.error) == (3, version, error)
    assert [part.tobytes() for part in found.rewards] == [part.tobytes() for part in parts]


def test_an_inconsistent_reply_is_a_wire_error() -> None:
    reply = ScoreReply(request=1, rewards=(np.ones(2, np.float32), np.ones(1, np.float32)), version=2)
    header, arrays = wire.decode(scoring.encode_reply(reply))
    for columns in (
        {**arrays, "steps": np.array([2, 2], np.uint32)},
        {**arrays, "rewards": np.array([1, 2, np.inf], np.float32)},
        {"steps": arrays["steps"]},
    ):
        with pytest.raises(WireError):
            scoring.decode_reply(wire.encode(header, columns))
    for field in ("request", "version", "error", "backlog"):
        with pytest.raises(WireError, match=field):
            scoring.decode_reply(wire.encode({**header, field: None}, arrays))


def test_encoding_refuses_an_empty_or_too_large_request() -> None:
    for refused in ([], [episode(1).trajectory] * (scoring.MAX_BATCH + 1)):
        with pytest.raises(ValueError, match="wanted 1 to"):
            scoring.encode_request(1, refused)
