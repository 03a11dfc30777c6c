"""Episodes as messages and as files: round trips, golden bytes, and errors for damaged or inconsistent ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from giirl_core.types import Episode, Trajectory
from giirl_core.wire import messages as wire
from giirl_core.wire.columns import header_fields, pack, unpack
from giirl_core.wire.messages import Stamp, WireError
from tests.giirl_core.wire_examples import (
    STAMP,
    assert_same_episode,
    assert_same_trajectory,
    episode,
    episodes,
    raw_message,
    trajectories,
    with_prefix,
)

GOLDEN = (
    "4749524c07000000d57a69f3aa7923db4002000000000000948ca46b696e64a7657069736f6465a372756ea57275"
    "6e2d31a56163746f72a76163746f722d37ab696e6361726e6174696f6e02a873657175656e636529a47461736bac"
    "636c69636b2d627574746f6ea4676f616cab436c69636b20224f6b222ea47365656405ae706f6c6963795f766572"
    "73696f6e03ae7265776172645f76657273696f6effaa7261775f726577617264cb3ff0000000000000a5656e6465"
    "64c3dc001ea57374657073a4726f7773a476657262a7656c656d656e74a57374617274a3656e64a2746fa26174a2"
    "6279ae6265686176696f75725f6c6f6770a772657761726473a773616d706c6573a773616d706c6564ac73616d70"
    "6c65645f6c6f6770af73616d706c65645f72657761726473a3726566a6706172656e74a3626f78a7666f63757365"
    "64a874616d7065726564a3746167a474657874a576616c7565a7636c6173736573a6636f6c6f7572a57368617065"
    "aa61747472696275746573a76c69746572616caa63686172616374657273ab737472696e675f656e6473dc001ea3"
    "3c7534a33c7534a37c6931a33c6934a33c6934a33c6934a33c6934a33c6638a33c6638a33c6634a33c6634a33c75"
    "34a33c6932a33c6634a33c6634a33c6934a33c6932a33c6634a37c6231a37c6231a33c7534a33c7534a33c7534a3"
    "3c7534a33c7534a33c7534a33c7534a33c7534a37c7531a33c7534dc001e91019101910191019101910191019201"
    "0292010291019101910192000491009100910391039203049103910391039103910391039103910391039101910f"
    "91050100000000000000030000000000000000000000000000000000000000000000ffffffff00000000ffffffff"
    "00000000ffffffff0000000000000000000000000000000000000000000000000000000000000000000000000000"
    "00bf000000000000000000000000000000000000000001000000020000000300000000000000ffffffffffff0000"
    "000000000000803f0000004000004040000080400000a0400000c0400000e0400000004100001041000020410000"
    "30410000000000000000010000000000000000000000000000000000000000000000010000000200000003000000"
    "00000000030000000300000003000000000000000400000004000000040000000000000003000000030000000300"
    "00000000000003000000030000000300000000000000030000000300000003000000000000000300000000000000"
    "627574746f6e4f6b4ec3a9776964650006000000080000000a0000000a0000000e00000000000000"
)


def altered(message: bytes, **columns: np.ndarray) -> bytes:
    """An episode message with some columns replaced and a valid checksum."""
    header, arrays = wire.decode(message)
    return wire.encode(header, {**arrays, **columns})


@given(
    episodes,
    st.integers(0, wire.MAX_COUNT - 1),
    st.text(alphabet=st.characters(codec="ascii", categories=["L", "N", "P"])),
)
def test_an_episode_survives_a_round_trip(sent: Episode, sequence: int, actor: str) -> None:
    stamp = Stamp(run="r", actor=actor, incarnation=0, sequence=sequence)
    found, found_stamp = wire.decode_episode(wire.encode_episode(sent, stamp=stamp))
    assert_same_episode(found, sent)
    assert found_stamp == stamp


@given(st.lists(trajectories(), max_size=4))
def test_many_trajectories_in_the_same_columns_survive_a_round_trip(sent: list[Trajectory]) -> None:
    for found, wanted in zip(unpack(pack(sent), [header_fields(one) for one in sent]), sent, strict=True):
        assert_same_trajectory(found, wanted)


def test_the_bytes_of_schema_version_7() -> None:
    assert wire.encode_episode(episode(1), stamp=STAMP).hex() == GOLDEN


def test_the_header_of_an_episode() -> None:
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


def test_equal_strings_are_stored_once() -> None:
    few, many = (wire.decode(wire.encode_episode(episode(n), stamp=STAMP))[1] for n in (1, 100))
    for name in ("characters", "string_ends"):
        assert few[name].tolist() == many[name].tolist()


@pytest.mark.parametrize("mask", [0x01, 0x80, 0xFF])
def test_any_flipped_byte_is_a_wire_error(mask: int) -> None:
    message = wire.encode_episode(episode(1), stamp=STAMP)
    for position in range(len(message)):
        damaged = message[:position] + bytes([message[position] ^ mask]) + message[position + 1 :]
        with pytest.raises(WireError):
            wire.decode_episode(damaged)


def test_a_truncated_message_is_a_wire_error() -> None:
    message = wire.encode_episode(episode(1), stamp=STAMP)
    for length in range(len(message)):
        with pytest.raises(WireError):
            wire.decode_episode(message[:length])
        if length >= wire.PREFIX.size:
            with pytest.raises(WireError):
                wire.decode_episode(with_prefix(message[wire.PREFIX.size : length]))


@given(st.data())
def test_a_message_with_bytes_removed_inserted_or_moved_is_a_wire_error(data: st.DataObject) -> None:
    message = wire.encode_episode(episode(1), stamp=STAMP)
    positions = st.integers(wire.PREFIX.size, len(message))
    first, last = sorted((data.draw(positions), data.draw(positions)))
    inserted = data.draw(st.binary(max_size=20))
    for damaged in (
        message[:first] + inserted + message[last:],
        message[:first] + message[last:] + message[first:last],
    ):
        if damaged != message:
            with pytest.raises(WireError):
                wire.decode_episode(damaged)
        if len(damaged) != len(message):
            with pytest.raises(WireError):
                wire.decode_episode(with_prefix(damaged[wire.PREFIX.size :]))


@given(st.dictionaries(st.text(max_size=8), st.integers() | st.text(max_size=3) | st.none(), max_size=3))
def test_a_header_without_the_fields_of_an_episode_is_a_wire_error(header: dict[str, object]) -> None:
    with pytest.raises(WireError):
        wire.decode_episode(raw_message([{**{k: repr(v) for k, v in header.items()}, "kind": "episode"}, [], [], []]))


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
def test_inconsistent_columns_are_a_wire_error(name: str, value: np.ndarray) -> None:
    message = wire.encode_episode(episode(2), stamp=STAMP)
    with pytest.raises(WireError):
        wire.decode_episode(altered(message, **{name: value}))


def test_an_episode_file_survives_a_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "some.episodes"
    sent = [episode(1, seed=1), episode(3, seed=2)]
    wire.write_episodes(path, sent)
    for found, wanted in zip(wire.read_episodes(path), sent, strict=True):
        assert_same_episode(found, wanted)
    wire.write_episodes(path, [])
    assert wire.read_episodes(path) == []
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_truncated_or_damaged_anywhere_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "some.episodes"
    wire.write_episodes(path, [episode(1)])
    whole = path.read_bytes()
    damaged = [whole[:position] + bytes([byte ^ 0xFF]) + whole[position + 1 :] for position, byte in enumerate(whole)]
    for data in [*(whole[:length] for length in range(len(whole))), *damaged, whole + b"\0"]:
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"some\.episodes is (not an episode file|damaged)") as caught:
            wire.read_episodes(path)
        assert "\n" not in str(caught.value)
        assert not isinstance(caught.value, WireError)


def test_a_failed_write_leaves_the_old_file_unchanged_and_no_other_files(tmp_path: Path) -> None:
    path = tmp_path / "some.episodes"
    wire.write_episodes(path, [episode(1)])
    before = path.read_bytes()
    with pytest.raises(AttributeError):
        wire.write_episodes(path, [episode(1), None])  # type: ignore[list-item]
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
