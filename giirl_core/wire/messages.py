"""The wire contract: what episodes and weights look like as bytes, on a socket and in a file.

A message is one run of bytes: a prefix (magic, schema version, XXH3 of all that follows), the length of a msgpack
header, that header, and columns of raw little-endian numbers, which the header names and measures. The header and each
column are filled up with zeros to a multiple of ALIGN, so that columns are read where they lie. Whatever is wrong with
a message is a WireError and nothing else; sizes are checked before anything is allocated.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from xxhash import xxh3_64_intdigest

from giirl_core.files import atomic_write
from giirl_core.types import Episode, Outcome
from giirl_core.wire import columns as cols
from giirl_core.wire.columns import Column, Columns, take

SCHEMA = 5
MAGIC = b"GIRL"
PREFIX = struct.Struct("<4sIQ")  # magic, schema, checksum
LENGTH = struct.Struct("<Q")
ALIGN = 8
GAPS = tuple(bytes(-size % ALIGN) for size in range(ALIGN))  # what to fill up with, by size modulo ALIGN
MAX_BYTES = 64 << 20
MAX_COUNT = 1 << 53  # of anything that is counted: sums of such still fit a message
MAX_NAME = 255
MAX_HEADER_BYTES = 1 << 20
MAX_COLUMNS = 64
MAX_DIMS = 4
DTYPES = {
    name: np.dtype(name) for name in ("|b1", "|i1", "|u1", "<i2", "<i4", "<i8", "<u2", "<u4", "<u8", "<f4", "<f8")
}
BOOLEAN = DTYPES["|b1"]
NAMES = {dtype: name for name, dtype in DTYPES.items()}
FILE_MAGIC = b"giirl episodes 3\n"
COUNT = struct.Struct("<I")
checksum = xxh3_64_intdigest

ALL = [-1]  # what numpy takes for "as much as there is"; it refuses other negative lengths by itself
Header = dict[str, Any]
Layout = tuple[list[Any], list[Any], list[Any]]  # names, types and shapes of columns, as somebody sent them


class WireError(ValueError):
    """A message that is not one of ours, or not whole."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamp:
    """Where an episode comes from: what delivery needs to know, and training does not."""

    run: str
    actor: str
    incarnation: int  # grows each time the actor is started again
    sequence: int  # counts the episodes of one incarnation from 0

    def __post_init__(self) -> None:
        if not (0 <= self.incarnation < MAX_COUNT and 0 <= self.sequence < MAX_COUNT):
            raise ValueError(f"incarnation {self.incarnation}, sequence {self.sequence}: wanted 0 to {MAX_COUNT}")
        for name in (self.run, self.actor):
            if len(name) > MAX_NAME or not (name.isascii() and name.isprintable()):
                raise ValueError(f"{name!r:.80} is no name: wanted up to {MAX_NAME} printable ASCII characters")


def encode(header: Mapping[str, object], arrays: Mapping[str, Column] | None = None) -> bytes:
    """One message; `header` says its "kind"."""
    if not isinstance(header.get("kind"), str):
        raise ValueError(f"a header needs a kind, got {header.get('kind')!r}")
    types: list[str] = []
    shapes: list[tuple[int, ...]] = []
    columns: list[Any] = []  # buffers, laid end to end
    for name, array in arrays.items() if arrays else ():
        dtype = NAMES.get(array.dtype)
        if dtype is None:
            array = array.astype(array.dtype.newbyteorder("<"))
            dtype = NAMES.get(array.dtype)
            if dtype is None:
                raise ValueError(f"column {name!r} is of type {array.dtype}, wanted one of {sorted(DTYPES)}")
        types.append(dtype)
        shapes.append(array.shape)
        columns += (np.ascontiguousarray(array), GAPS[array.nbytes % ALIGN])
    try:
        body = msgpack.packb([dict(header), list(arrays or ()), types, shapes], unicode_errors="surrogatepass")
    except (TypeError, OverflowError) as error:
        raise ValueError(f"header of kind {header['kind']!r} cannot be packed: {error}") from error
    sealed = b"".join([LENGTH.pack(len(body)), body, GAPS[len(body) % ALIGN], *columns])
    _check_limits(len(body), len(types), PREFIX.size + len(sealed), MAX_BYTES)
    return PREFIX.pack(MAGIC, SCHEMA, checksum(sealed)) + sealed


def decode(message: bytes, *, max_bytes: int = MAX_BYTES) -> tuple[Header, Columns]:
    """Header and columns of one message; the columns are read-only views of it."""
    start = PREFIX.size + LENGTH.size
    if len(message) < start:
        raise WireError(f"a message of {len(message)} bytes has no whole prefix, wanted {start} or more")
    magic, schema, promised = PREFIX.unpack_from(message)
    if magic != MAGIC:
        raise WireError(f"a message starts with {magic!r}, wanted {MAGIC!r}")
    if schema != SCHEMA:
        raise WireError(f"a message has schema {schema}, this program speaks {SCHEMA}: use one version on both sides")
    sealed = memoryview(message)[PREFIX.size :]
    (length,) = LENGTH.unpack_from(sealed)
    _check_limits(length, 0, len(message), max_bytes)
    if (found := checksum(sealed)) != promised:
        raise WireError(f"a message is damaged: checksum {found:016x}, wanted {promised:016x}")
    header, layout = _unpack_header(message[start : start + length])
    _check_limits(length, len(layout[0]), len(message), max_bytes)
    return header, _columns(layout, message, start + length + -length % ALIGN)


def encode_episode(episode: Episode, *, stamp: Stamp) -> bytes:
    """One finished episode and where it comes from."""
    header = {
        "kind": "episode",
        "run": stamp.run,
        "actor": stamp.actor,
        "incarnation": stamp.incarnation,
        "sequence": stamp.sequence,
        **cols.head(episode.trajectory),
        "raw_reward": float(episode.outcome.raw_reward),
        "ended": bool(episode.outcome.ended),
    }
    return encode(header, cols.pack([episode.trajectory]))


def decode_episode(message: bytes) -> tuple[Episode, Stamp]:
    """The inverse of `encode_episode`."""
    header, arrays = decode(message)
    return build_episode(header, arrays), read_stamp(header)


def read_stamp(header: Header) -> Stamp:
    """Where a decoded message of an actor comes from."""
    with untrusted():
        return Stamp(
            run=take(header, "run", str),
            actor=take(header, "actor", str),
            incarnation=take(header, "incarnation", int),
            sequence=take(header, "sequence", int),
        )


def build_episode(header: Header, arrays: Columns) -> Episode:
    """The episode of a decoded message."""
    expect(header, "episode")
    with untrusted():
        reward = take(header, "raw_reward", float)
        if not math.isfinite(reward):
            raise WireError(f"header field 'raw_reward' is {reward}, wanted a finite number")
        (trajectory,) = cols.unpack(arrays, [header])
        return Episode(trajectory=trajectory, outcome=Outcome(raw_reward=reward, ended=take(header, "ended", bool)))


def write_episodes(path: Path, episodes: Sequence[Episode]) -> None:
    """Write a file of episodes, whole or not at all."""
    with atomic_write(path) as file:
        file.write(FILE_MAGIC + COUNT.pack(len(episodes)))
        for number, episode in enumerate(episodes):
            message = encode_episode(episode, stamp=Stamp(run="", actor="", incarnation=0, sequence=number))
            file.writelines([COUNT.pack(len(message)), message])


def read_episodes(path: Path) -> list[Episode]:
    """The episodes of a file that `write_episodes` wrote."""
    data = path.read_bytes()
    if not data.startswith(FILE_MAGIC):
        raise ValueError(f"{path} is no episode file: it starts with {data[:16]!r}, wanted {FILE_MAGIC!r}")
    episodes: list[Episode] = []
    try:
        count, offset = _number(data, len(FILE_MAGIC))
        while offset < len(data):
            size, offset = _number(data, offset)
            episode, stamp = decode_episode(_piece(data, offset, size))
            offset += size
            if stamp.sequence != len(episodes):
                raise WireError(f"episode {stamp.sequence} stands where {len(episodes)} should")
            episodes.append(episode)
        if len(episodes) != count:
            raise WireError(f"it holds {len(episodes)} episodes, its head promises {count}")
    except WireError as error:
        raise ValueError(f"{path} is damaged at episode {len(episodes)}: {error}; wanted a whole file") from error
    return episodes


def expect(header: Header, kind: str) -> None:
    """Refuse a message of another kind."""
    if header.get("kind") != kind:
        raise WireError(f"a message is of kind {header.get('kind')!r:.80}, wanted {kind!r}")


class untrusted:  # noqa: N801 - it reads as a block; each message passes several, so it is no generator
    """Values are built here from what a peer sent: what the values refuse is the message's fault."""

    def __enter__(self) -> None: ...

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ValueError) and not isinstance(error, WireError):
            raise WireError(str(error)) from error


def _check_limits(header_bytes: int, columns: int, size: int, max_bytes: int) -> None:
    if header_bytes > MAX_HEADER_BYTES or columns > MAX_COLUMNS or size > max_bytes:
        raise WireError(
            f"a message of {header_bytes} header bytes, {columns} columns and {size} bytes in all is too big: "
            f"wanted {MAX_HEADER_BYTES}, {MAX_COLUMNS} and {max_bytes} at most"
        )


def _unpack_header(body: bytes) -> tuple[Header, Layout]:
    try:
        # What the body's own length does not bound (strings, lists, maps) msgpack bounds by it.
        content = msgpack.unpackb(body, unicode_errors="surrogatepass", max_bin_len=0, max_ext_len=0)
    except (ValueError, msgpack.UnpackException) as error:
        raise WireError(f"a header is not msgpack: {error}") from error
    match content:
        case [{"kind": str()} as header, list() as names, list() as types, list() as shapes]:
            if set(map(type, header)) == {str} and len(names) == len(types) == len(shapes):
                return header, (names, types, shapes)
    raise WireError(f"a header is {content!r:.80}, wanted fields with a kind, and names, types and shapes of columns")


def _columns(layout: Layout, message: bytes, offset: int) -> Columns:
    """Every message has dozens of these: what is as it should be passes few questions, and numpy asks the others."""
    arrays: Columns = {}
    ndarray = np.ndarray
    for name, dtype, shape in zip(*layout, strict=True):
        try:
            kind = DTYPES[dtype]
            if type(name) is not str or name in arrays or type(shape) is not list or len(shape) > MAX_DIMS:
                raise ValueError("no name of its own, or no shape")
            if shape == ALL:
                raise ValueError("no length")
            array: Column = ndarray(shape, kind, message, offset)
        except (TypeError, ValueError, KeyError) as error:
            told = f"column {name!r:.80} of type {dtype!r:.80} and shape {shape!r:.80}"
            raise WireError(f"{told} is none of this message: {error}") from error
        size = array.nbytes
        if kind is BOOLEAN and message[offset : offset + size].translate(None, b"\0\1"):
            raise WireError(f"column {name!r:.80} holds a byte above 1, wanted 0 for False and 1 for True")
        arrays[name] = array
        offset += size + -size % ALIGN
    if offset != len(message):
        raise WireError(f"a message of {len(message)} bytes has columns up to byte {offset}")
    return arrays


def _number(data: bytes, offset: int) -> tuple[int, int]:
    return int.from_bytes(_piece(data, offset, COUNT.size), "little"), offset + COUNT.size


def _piece(data: bytes, offset: int, size: int) -> bytes:
    if offset + size > len(data):
        raise WireError(f"it ends after {len(data)} bytes, something in it reaches to {offset + size}")
    return data[offset : offset + size]
