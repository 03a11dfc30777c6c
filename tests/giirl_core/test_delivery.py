"""Messages of whatever kind: columns that come back, and the one error for everything else."""

from __future__ import annotations

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as np_st

from giirl_core.wire import messages as wire
from giirl_core.wire.messages import Stamp, WireError
from tests.giirl_core.wire_examples import STAMP, episode, sealed, sealed_bytes, signed

COLUMNS = st.sampled_from([dtype for dtype in wire.DTYPES if dtype != "|b1"]).flatmap(
    lambda dtype: np_st.arrays(dtype, np_st.array_shapes(min_dims=0, max_dims=wire.MAX_DIMS, min_side=0, max_side=3))
)


@given(st.dictionaries(st.text(max_size=9), COLUMNS, max_size=9))
def test_columns_of_any_type_and_shape_come_back_where_they_can_be_read_in_place(sent: dict[str, np.ndarray]) -> None:
    _, found = wire.decode(wire.encode({"kind": "x"}, sent))
    assert found.keys() == sent.keys()
    for name, array in found.items():
        assert (array.dtype, array.shape, array.tobytes()) == (sent[name].dtype, sent[name].shape, sent[name].tobytes())
        assert array.flags.aligned
        assert not array.flags.writeable


def test_columns_that_lie_in_memory_in_another_order_are_sent_in_ours() -> None:
    plain = np.arange(12, dtype="<i4").reshape(3, 4)
    for strange in (np.asfortranarray(plain), plain.astype(">i4"), np.repeat(plain, 2, axis=1)[:, ::2]):
        _, found = wire.decode(wire.encode({"kind": "x"}, {"a": strange}))
        assert found["a"].tolist() == plain.tolist()


@given(st.binary(max_size=99))
def test_noise_is_a_wire_error(message: bytes) -> None:
    with pytest.raises(WireError):
        wire.decode(message)


@given(st.binary(max_size=60), st.binary(max_size=16))
def test_noise_with_a_right_checksum_is_a_wire_error(body: bytes, rest: bytes) -> None:
    for message in (signed(body + rest), sealed_bytes(body, rest)):
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
def test_a_column_that_lies_about_itself_is_a_wire_error(layout: list[object]) -> None:
    with pytest.raises(WireError):
        wire.decode(sealed([{"kind": "x"}, *layout], b"12345678"))


@pytest.mark.parametrize("length", [0, 1, 40, 1 << 16, 1 << 32, 1 << 63])
def test_a_header_that_lies_about_its_length_is_a_wire_error(length: int) -> None:
    body = msgpack.packb([{"kind": "x"}, ["a"], ["<f4"], [[2]]])
    with pytest.raises(WireError):
        wire.decode(signed(wire.LENGTH.pack(length) + body + wire.GAPS[len(body) % wire.ALIGN] + b"12345678"))


def test_a_boolean_column_holds_nothing_but_0_and_1() -> None:
    with pytest.raises(WireError, match="above 1"):
        wire.decode(sealed([{"kind": "x"}, ["a"], ["|b1"], [[1]]], b"\x02" + bytes(7)))


def test_a_message_beyond_the_limit_is_refused_before_it_is_read() -> None:
    message = wire.encode_episode(episode(), stamp=STAMP)
    wire.decode(message, max_bytes=len(message))
    with pytest.raises(WireError, match="too big"):
        wire.decode(message, max_bytes=len(message) - 1)
    names = [str(n) for n in range(wire.MAX_COLUMNS + 1)]
    with pytest.raises(WireError, match="too big"):
        wire.decode(sealed([{"kind": "x"}, names, ["<f4"] * len(names), [[0]] * len(names)]))
    with pytest.raises(WireError, match="too big"):
        wire.encode({"kind": "x", "text": "a" * wire.MAX_HEADER_BYTES})


def test_another_schema_is_named_in_the_error() -> None:
    message = wire.encode({"kind": "x"})
    other = wire.PREFIX.pack(wire.MAGIC, wire.SCHEMA + 1, 0) + message[wire.PREFIX.size :]
    with pytest.raises(WireError, match="schema 6, this program speaks 5"):
        wire.decode(other)


def test_a_deeply_nested_header_is_a_wire_error() -> None:
    with pytest.raises(WireError):
        wire.decode(sealed_bytes(b"\x91" * 100_000 + b"\xc0"))


def test_what_cannot_be_sent_is_refused_where_it_was_made() -> None:
    with pytest.raises(ValueError, match="kind"):
        wire.encode({"run": "x"})
    with pytest.raises(ValueError, match="object"):
        wire.encode({"kind": "x"}, {"a": np.array([None])})
    with pytest.raises(ValueError, match="cannot be packed"):
        wire.encode({"kind": "x", "seed": 2**80})
    with pytest.raises(ValueError, match="incarnation"):
        Stamp(run="", actor="", incarnation=-1, sequence=0)
    with pytest.raises(ValueError, match="sequence"):
        Stamp(run="", actor="", incarnation=0, sequence=1 << 60)
    for name in ("\ud800", "a\nb", "x" * 300):
        with pytest.raises(ValueError, match="no name"):
            Stamp(run="r", actor=name, incarnation=0, sequence=0)
