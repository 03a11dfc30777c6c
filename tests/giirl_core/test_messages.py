"""The message format: round trips of columns, and WireError for everything malformed."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as np_st

from giirl_core.wire import messages as wire
from giirl_core.wire.messages import Stamp, WireError
from tests.giirl_core.wire_examples import STAMP, episode, raw_message, raw_message_bytes, with_prefix

COLUMNS = st.sampled_from([dtype for dtype in wire.DTYPES if dtype != "|b1"]).flatmap(
    lambda dtype: np_st.arrays(dtype, np_st.array_shapes(min_dims=0, max_dims=wire.MAX_DIMS, min_side=0, max_side=3))
)


@given(st.dictionaries(st.text(max_size=9), COLUMNS, max_size=9))
def test_columns_of_any_dtype_and_shape_survive_a_round_trip_and_are_aligned(sent: dict[str, np.ndarray]) -> None:
    _, found = wire.decode(wire.encode({"kind": "x"}, sent))
    assert found.keys() == sent.keys()
    for name, array in found.items():
        assert (array.dtype, array.shape, array.tobytes()) == (sent[name].dtype, sent[name].shape, sent[name].tobytes())
        assert array.flags.aligned
        assert not array.flags.writeable


def test_columns_with_another_memory_layout_or_byte_order_are_converted() -> None:
    plain = np.arange(12, dtype="<i4").reshape(3, 4)
    for other in (np.asfortranarray(plain), plain.astype(">i4"), np.repeat(plain, 2, axis=1)[:, ::2]):
        _, found = wire.decode(wire.encode({"kind": "x"}, {"a": other}))
        assert found["a"].tolist() == plain.tolist()


@given(st.binary(max_size=99))
def test_random_bytes_are_a_wire_error(message: bytes) -> None:
    with pytest.raises(WireError):
        wire.decode(message)


@given(st.binary(max_size=60), st.binary(max_size=16))
def test_random_bytes_with_a_valid_checksum_are_a_wire_error(body: bytes, rest: bytes) -> None:
    for message in (with_prefix(body + rest), raw_message_bytes(body, rest)):
        with pytest.raises(WireError):
            wire.decode_episode(message)


@pytest.mark.parametrize(
    "layout",
    [
        [["a"], ["|O8"], [[1]]],
        [["a"], ["<f4"], [[2**62]]],
        [["a"], ["<f4"], [[2**63]]],
        [["a"], ["<f4"], [[-1]]],
        [["a"], ["<f4"], [[-2, -1]]],
        [["a"], ["<f4"], [[True]]],
        [["a"], ["<f4"], [[1, True]]],
        [["a"], ["<f4"], [[1.0]]],
        [["a"], ["<f4"], [[None]]],
        [["a"], ["<f4"], [[1, 1, 1, 1, 1]]],
        [["a"], ["<f4"], [[0, 2**26, 2**26, 2**26]]],
        [["a"], ["<f4"], [[0]]],
        [["a"], ["<f4"], [[3]]],
        [["a"], ["<f4"], ["1"]],
        [["a"], ["<f4"], [1]],
        [["a"], ["<f4"]],
        [["a"], ["<f4"], []],
        [["a"], [4], [[1]]],
        [[7], ["<f4"], [[1]]],
        [[["a"]], ["<f4"], [[1]]],
        [["a"], [["<f4"]], [[1]]],
        [["a", "a"], ["<f4", "<f4"], [[1], [0]]],
        ["a", "a", "a"],
        [[], [], []],
        [],
    ],
    ids=repr,
)
def test_a_bad_description_of_the_columns_is_a_wire_error(layout: list[object]) -> None:
    with pytest.raises(WireError):
        wire.decode(raw_message([{"kind": "x"}, *layout], b"12345678"))


@pytest.mark.parametrize("length", [0, 1, 40, 1 << 16, 1 << 32, 1 << 63])
def test_a_wrong_header_length_is_a_wire_error(length: int) -> None:
    body = msgpack.packb([{"kind": "x"}, ["a"], ["<f4"], [[2]]])
    with pytest.raises(WireError):
        wire.decode(with_prefix(wire.LENGTH.pack(length) + body + wire.PADDING[len(body) % wire.ALIGN] + b"12345678"))


def test_a_boolean_column_with_a_byte_above_1_is_a_wire_error() -> None:
    with pytest.raises(WireError, match="above 1"):
        wire.decode(raw_message([{"kind": "x"}, ["a"], ["|b1"], [[1]]], b"\x02" + bytes(7)))


def test_a_message_over_a_limit_is_a_wire_error() -> None:
    message = wire.encode_episode(episode(), stamp=STAMP)
    wire.decode(message, max_bytes=len(message))
    with pytest.raises(WireError, match="too big"):
        wire.decode(message, max_bytes=len(message) - 1)
    names = [str(n) for n in range(wire.MAX_COLUMNS + 1)]
    with pytest.raises(WireError, match="too big"):
        wire.decode(raw_message([{"kind": "x"}, names, ["<f4"] * len(names), [[0]] * len(names)]))
    with pytest.raises(WireError, match="too big"):
        wire.encode({"kind": "x", "text": "a" * wire.MAX_HEADER_BYTES})


def test_the_error_names_both_schema_versions() -> None:
    message = wire.encode({"kind": "x"})
    other = wire.PREFIX.pack(wire.MAGIC, wire.SCHEMA_VERSION + 1, 0) + message[wire.PREFIX.size :]
    with pytest.raises(WireError, match="schema version 8, wanted 7"):
        wire.decode(other)


def test_a_deeply_nested_header_is_a_wire_error() -> None:
    with pytest.raises(WireError):
        wire.decode(raw_message_bytes(b"\x91" * 100_000 + b"\xc0"))


def test_encoding_refuses_what_the_format_cannot_express() -> None:
    with pytest.raises(ValueError, match="kind"):
        wire.encode({"run": "x"})
    with pytest.raises(ValueError, match="has dtype object"):
        wire.encode({"kind": "x"}, {"a": np.array([None])})
    with pytest.raises(ValueError, match="cannot be encoded"):
        wire.encode({"kind": "x", "seed": 2**80})
    with pytest.raises(ValueError, match="incarnation"):
        Stamp(run="", actor="", incarnation=-1, sequence=0)
    with pytest.raises(ValueError, match="sequence"):
        Stamp(run="", actor="", incarnation=0, sequence=1 << 60)
    for name in ("\ud800", "a\nb", "x" * 300):
        with pytest.raises(ValueError, match="printable ASCII"):
            Stamp(run="r", actor=name, incarnation=0, sequence=0)
