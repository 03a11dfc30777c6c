"""The wire contract: what it promises of good bytes, and of all others."""

from __future__ import annotations

from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl import wire
from giirl.columns import head, pack, unpack
from giirl.spec import Episode, Trajectory
from giirl.wire import Stamp, WireError
from tests.wire.examples import (
    STAMP,
    assert_same_episode,
    assert_same_trajectory,
    episode,
    episodes,
    trajectories,
)

GOLDEN = (
    "4749524c030095b57faa7763d98f928ca46b696e64a7657069736f6465a372756ea572756e2d31a56163746f72a761"
    "63746f722d37ab696e6361726e6174696f6e02a873657175656e636529a47461736bac636c69636b2d627574746f6e"
    "a4676f616cab436c69636b20224f6b222ea47365656405ae706f6c6963795f76657273696f6e03ae7265776172645f"
    "76657273696f6effaa7261775f726577617264cb3ff0000000000000a5656e646564c3dc001993a57374657073a33c"
    "7534910193a4726f7773a33c7534910193a476657262a37c6931910193a7656c656d656e74a33c6934910193a57374"
    "617274a33c6934910193a3656e64a33c6934910193a2746fa33c6934910193a26174a33c663892010293a26279a33c"
    "663892010293ae6265686176696f75725f6c6f6770a33c6634910193a772657761726473a33c6634910193a3726566"
    "a33c6934910393a6706172656e74a33c6932910393a3626f78a33c663492030493a7666f6375736564a37c62319103"
    "93a874616d7065726564a37c6231910393a3746167a33c7534910393a474657874a33c7534910393a576616c7565a3"
    "3c7534910393a7636c6173736573a33c7534910393a6636f6c6f7572a33c7534910393a57368617065a33c75349103"
    "93a76c69746572616ca33c7534910193aa63686172616374657273a37c7531910f93ab737472696e675f656e6473a3"
    "3c753491057c010000007c030000007c007c000000007cffffffff7cffffffff7cffffffff7c000000000000000000"
    "000000000000007c000000000000000000000000000000007c000000bf7c000000007c010000000200000003000000"
    "7cffffffffffff7c000000000000803f0000004000004040000080400000a0400000c0400000e04000000041000010"
    "4100002041000030417c0000007c0100007c0000000000000000000000007c0100000002000000030000007c030000"
    "0003000000030000007c0400000004000000040000007c0300000003000000030000007c0300000003000000030000"
    "007c030000007c627574746f6e4f6b4ec3a9776964657c06000000080000000a0000000a0000000e000000"
)


def sealed(body: object, *frames: bytes) -> list[bytes]:
    """A message whose checksum is right, whatever it says."""
    parts = [msgpack.packb(body), *frames]
    return [wire.PREFIX.pack(wire.MAGIC, wire.SCHEMA, wire.checksum(parts)) + parts[0], *parts[1:]]


def altered(frames: list[bytes], **columns: np.ndarray) -> list[bytes]:
    """An episode message with other columns, sealed again."""
    header, arrays = wire.decode(frames)
    return wire.encode(header, {**arrays, **columns})


@given(episodes, st.integers(0, 2**63), st.text(max_size=20))
def test_an_episode_comes_back_as_it_was_sent(sent: Episode, sequence: int, actor: str) -> None:
    stamp = Stamp(run="r", actor=actor, incarnation=0, sequence=sequence)
    found, found_stamp = wire.decode_episode(wire.encode_episode(sent, stamp=stamp))
    assert_same_episode(found, sent)
    assert found_stamp == stamp


@given(st.lists(trajectories(), max_size=4))
def test_many_trajectories_share_columns_and_come_apart_again(sent: list[Trajectory]) -> None:
    for found, wanted in zip(unpack(pack(sent), [head(one) for one in sent]), sent, strict=True):
        assert_same_trajectory(found, wanted)


def test_the_bytes_of_schema_3_are_these() -> None:
    assert b"|".join(wire.encode_episode(episode(1), stamp=STAMP)).hex() == GOLDEN


def test_the_header_says_what_delivery_and_a_reader_of_logs_need() -> None:
    header, _ = wire.decode(wire.encode_episode(episode(), stamp=STAMP))
    assert header == {
        "kind": "episode",
        "run": "run-1",
        "actor": "actor-7",
        "incarnation": 2,
        "sequence": 41,
        "task": "click-button",
        "goal": 'Click "Ok".',
        "seed": 5,
        "policy_version": 3,
        "reward_version": -1,
        "raw_reward": 1.0,
        "ended": True,
    }


def test_equal_strings_are_carried_once() -> None:
    few, many = (sum(map(len, wire.encode_episode(episode(n), stamp=STAMP)[-2:])) for n in (1, 100))
    assert few == many


@pytest.mark.parametrize("mask", [0x01, 0x80, 0xFF])
def test_any_flipped_byte_is_a_wire_error(mask: int) -> None:
    frames = wire.encode_episode(episode(1), stamp=STAMP)
    for number, frame in enumerate(frames):
        for place in range(len(frame)):
            spoiled = frame[:place] + bytes([frame[place] ^ mask]) + frame[place + 1 :]
            with pytest.raises(WireError):
                wire.decode_episode([*frames[:number], spoiled, *frames[number + 1 :]])


def test_a_truncated_frame_is_a_wire_error_and_nothing_else() -> None:
    frames = wire.encode_episode(episode(1), stamp=STAMP)
    for number, frame in enumerate(frames):
        for length in range(len(frame)):
            with pytest.raises(WireError):
                wire.decode_episode([*frames[:number], frame[:length], *frames[number + 1 :]])


def test_a_missing_doubled_or_misplaced_frame_is_a_wire_error() -> None:
    frames = wire.encode_episode(episode(1), stamp=STAMP)
    for number in range(len(frames)):
        for wrong in ([], [frames[number]] * 2):
            with pytest.raises(WireError):
                wire.decode_episode([*frames[:number], *wrong, *frames[number + 1 :]])
    with pytest.raises(WireError):
        wire.decode_episode([frames[0], *reversed(frames[1:])])


@given(st.lists(st.binary(max_size=40), max_size=4))
def test_noise_is_a_wire_error(frames: list[bytes]) -> None:
    with pytest.raises(WireError):
        wire.decode(frames)


@given(st.binary(max_size=60), st.lists(st.binary(max_size=8), max_size=2))
def test_noise_with_a_right_checksum_is_a_wire_error(body: bytes, rest: list[bytes]) -> None:
    prefix = wire.PREFIX.pack(wire.MAGIC, wire.SCHEMA, wire.checksum([body, *rest]))
    with pytest.raises(WireError):
        wire.decode_episode([prefix + body, *rest])


@given(st.dictionaries(st.text(max_size=8), st.integers() | st.text(max_size=3) | st.none(), max_size=3))
def test_a_header_that_is_no_episodes_is_a_wire_error(header: dict[str, object]) -> None:
    with pytest.raises(WireError):
        wire.decode_episode(sealed([{**{k: repr(v) for k, v in header.items()}, "kind": "episode"}, []]))


@pytest.mark.parametrize(
    "layout",
    [
        [["a", "|O8", [1]]],
        [["a", "<f4", [2**62]]],
        [["a", "<f4", [-1]]],
        [["a", "<f4", [True]]],
        [["a", "<f4", [1, 1, 1, 1, 1]]],
        [["a", "<f4", [0, 2**26, 2**26, 2**26]]],
        [["a", "<f4", "1"]],
        [["a", "<f4"]],
        [[b"a", "<f4", [1]]],
        [["a", ["<f4"], [1]]],
        [["a", "<f4", [1]], ["a", "<f4", [1]]],
        "a",
        [],
    ],
    ids=repr,
)
def test_a_column_that_lies_about_itself_is_a_wire_error(layout: object) -> None:
    frames = [b"1234"] * (len(layout) if isinstance(layout, list) else 1)
    with pytest.raises(WireError):
        wire.decode(sealed([{"kind": "x"}, layout], *(frames or [b"1234"])))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("rows", np.array([0, 6], np.uint32)),
        ("rows", np.array([2, 3], np.uint32)),
        ("rows", np.array([2**32 - 1, 7], np.uint32)),
        ("rows", np.array([3], np.uint32)),
        ("steps", np.array([1], np.uint32)),
        ("steps", np.array([1, 1], np.uint32)),
        ("verb", np.array([0, 12], np.int8)),
        ("verb", np.array([0, -1], np.int8)),
        ("element", np.array([0, 3], np.int32)),
        ("element", np.array([0, -2], np.int32)),
        ("to", np.array([0, 1], np.int32)),
        ("at", np.full((2, 2), np.nan)),
        ("literal", np.array([0, 99], np.uint32)),
        ("start", np.array([0, 99], np.int32)),
        ("tag", np.full(6, 99, np.uint32)),
        ("parent", np.array([-1, -1, 2, -1, -1, -1], np.int16)),
        ("parent", np.full(6, -2, np.int16)),
        ("box", np.zeros((6, 3), np.float32)),
        ("box", np.full((6, 4), np.inf, np.float32)),
        ("behaviour_logp", np.array([0, np.nan], np.float32)),
        ("rewards", np.zeros(2, np.float64)),
        ("string_ends", np.array([9, 1, 2, 3], np.uint32)),
        ("string_ends", np.array([], np.uint32)),
        ("characters", np.full(12, 0xFF, np.uint8)),
        ("surplus", np.zeros(1, np.uint8)),
    ],
    ids=repr,
)
def test_columns_that_contradict_each_other_are_a_wire_error(name: str, value: np.ndarray) -> None:
    frames = wire.encode_episode(episode(2), stamp=STAMP)
    with pytest.raises(WireError):
        wire.decode_episode(altered(frames, **{name: value}))


def test_a_boolean_column_holds_nothing_but_0_and_1() -> None:
    with pytest.raises(WireError, match="above 1"):
        wire.decode(sealed([{"kind": "x"}, [["a", "|b1", [1]]]], b"\x02"))


def test_a_message_beyond_the_limit_is_refused_before_it_is_read() -> None:
    frames = wire.encode_episode(episode(), stamp=STAMP)
    with pytest.raises(WireError, match="too big"):
        wire.decode(frames, max_bytes=100)
    with pytest.raises(WireError, match="too big"):
        wire.decode([frames[0], *[b""] * wire.MAX_FRAMES])
    with pytest.raises(WireError, match="too big"):
        wire.encode({"kind": "x", "text": "a" * wire.MAX_HEADER_BYTES})


def test_another_schema_is_named_in_the_error() -> None:
    frames = wire.encode({"kind": "x"})
    other = wire.PREFIX.pack(wire.MAGIC, wire.SCHEMA + 1, 0) + frames[0][wire.PREFIX.size :]
    with pytest.raises(WireError, match="schema 4, this program speaks 3"):
        wire.decode([other])


def test_a_deeply_nested_header_is_a_wire_error() -> None:
    body = b"\x91" * 100_000 + b"\xc0"
    with pytest.raises(WireError):
        wire.decode([wire.PREFIX.pack(wire.MAGIC, wire.SCHEMA, wire.checksum([body])) + body])


def test_what_cannot_be_sent_is_refused_where_it_was_made() -> None:
    with pytest.raises(ValueError, match="kind"):
        wire.encode({"run": "x"})
    with pytest.raises(ValueError, match="object"):
        wire.encode({"kind": "x"}, {"a": np.array([None])})
    with pytest.raises(ValueError, match="cannot be packed"):
        wire.encode({"kind": "x", "seed": 2**80})
    with pytest.raises(ValueError, match="incarnation"):
        Stamp(run="", actor="", incarnation=-1, sequence=0)


def test_a_file_of_episodes_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "some.episodes"
    sent = [episode(1, seed=1), episode(3, seed=2)]
    wire.write_episodes(path, sent)
    for found, wanted in zip(wire.read_episodes(path), sent, strict=True):
        assert_same_episode(found, wanted)
    wire.write_episodes(path, [])
    assert wire.read_episodes(path) == []
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_cut_anywhere_or_spoiled_anywhere_says_so_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "some.episodes"
    wire.write_episodes(path, [episode(1)])
    whole = path.read_bytes()
    spoiled = [whole[:place] + bytes([byte ^ 0xFF]) + whole[place + 1 :] for place, byte in enumerate(whole)]
    for data in [*(whole[:length] for length in range(len(whole))), *spoiled, whole + b"\0"]:
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"some\.episodes is (no episode file|damaged)") as caught:
            wire.read_episodes(path)
        assert "\n" not in str(caught.value)
        assert not isinstance(caught.value, WireError)


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "some.episodes"
    wire.write_episodes(path, [episode(1)])
    before = path.read_bytes()
    with pytest.raises(AttributeError):
        wire.write_episodes(path, [episode(1), None])  # type: ignore[list-item]
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
