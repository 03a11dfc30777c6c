"""The wire format: how messages and episodes are encoded as bytes, for sockets and for files.

    offset  size  content
    0       4     magic, b"GIRL"
    4       4     schema version
    8       8     XXH3 checksum of all bytes that follow
    16      8     length of the header
    24      ...   header: msgpack of [fields, column names, column dtypes, column shapes]
    ...     ...   columns: raw little-endian numbers, one column after another

All integers are little-endian. The header and each column are padded with zeros to a multiple of ALIGN, so that columns
can be read in place, without a copy. Messages come from untrusted peers: sizes are checked before anything is
allocated, and every defect of a message raises WireError and no other exception.
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
from giirl_core.wire.columns import Column, Columns, read_field

SCHEMA_VERSION = 7
MAGIC = b"GIRL"
PREFIX = struct.Struct("<4sIQ")  # magic, schema version, checksum
LENGTH = struct.Struct("<Q")
ALIGN = 8
PADDING = tuple(bytes(-size % ALIGN) for size in range(ALIGN))  # zeros to append, by size modulo ALIGN
MAX_BYTES = 64 << 20
MAX_COUNT = 1 << 53  # upper bound of every counter, so that sums of counters still fit into 64 bits
MAX_NAME_LENGTH = 255
MAX_HEADER_BYTES = 1 << 20
MAX_COLUMNS = 64
MAX_DIMS = 4
DTYPES = {
    name: np.dtype(name) for name in ("|b1", "|i1", "|u1", "<i2", "<i4", "<i8", "<u2", "<u4", "<u8", "<f4", "<f8")
}
BOOLEAN = DTYPES["|b1"]
DTYPE_NAMES = {dtype: name for name, dtype in DTYPES.items()}
FILE_MAGIC = b"giirl episodes 3\n"
COUNT = struct.Struct("<I")
checksum = xxh3_64_intdigest

INFER_LENGTH = [-1]  # numpy reads this shape as "all remaining bytes"; it rejects other negative lengths itself
Header = dict[str, Any]
Layout = tuple[list[Any], list[Any], list[Any]]  # names, dtypes and shapes of columns, not checked yet


class WireError(ValueError):
    """A message that is malformed, damaged, incomplete or of another schema version."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamp:
    """The origin of an actor's message, needed for delivery but not for training.

    Raises ValueError when a number is out of range or a name is too long or not printable ASCII.
    """

    run: str
    actor: str
    incarnation: int  # grows with every restart of the actor
    sequence: int  # number of the episode within the incarnation, from 0

    def __post_init__(self) -> None:
        if not (0 <= self.incarnation < MAX_COUNT and 0 <= self.sequence < MAX_COUNT):
            raise ValueError(
                f"Stamp has incarnation {self.incarnation} and sequence {self.sequence}, wanted 0 to {MAX_COUNT - 1}"
            )
        for name in (self.run, self.actor):
            if len(name) > MAX_NAME_LENGTH or not (name.isascii() and name.isprintable()):
                raise ValueError(
                    f"Stamp has the name {name!r:.80}, wanted at most {MAX_NAME_LENGTH} printable ASCII characters"
                )


def encode(header: Mapping[str, object], arrays: Mapping[str, Column] | None = None) -> bytes:
    """One message; `header` must have a field "kind". Raises ValueError for what the format cannot express."""
    if not isinstance(header.get("kind"), str):
        raise ValueError(f"header field 'kind' is {header.get('kind')!r}, wanted a string")
    dtypes: list[str] = []
    shapes: list[tuple[int, ...]] = []
    columns: list[Any] = []  # buffers, each followed by its padding
    for name, array in arrays.items() if arrays else ():
        dtype = DTYPE_NAMES.get(array.dtype)
        if dtype is None:
            array = array.astype(array.dtype.newbyteorder("<"))
            dtype = DTYPE_NAMES.get(array.dtype)
            if dtype is None:
                raise ValueError(f"column {name!r} has dtype {array.dtype}, wanted one of {sorted(DTYPES)}")
        dtypes.append(dtype)
        shapes.append(array.shape)
        columns += (np.ascontiguousarray(array), PADDING[array.nbytes % ALIGN])
    try:
        packed = msgpack.packb([dict(header), list(arrays or ()), dtypes, shapes], unicode_errors="surrogatepass")
    except (TypeError, OverflowError) as error:
        raise ValueError(f"header of kind {header['kind']!r} cannot be encoded: {error}") from error
    body = b"".join([LENGTH.pack(len(packed)), packed, PADDING[len(packed) % ALIGN], *columns])
    _check_limits(len(packed), len(dtypes), PREFIX.size + len(body), MAX_BYTES)
    return PREFIX.pack(MAGIC, SCHEMA_VERSION, checksum(body)) + body


def decode(message: bytes, *, max_bytes: int = MAX_BYTES) -> tuple[Header, Columns]:
    """The header and the columns of one message; the columns are read-only views of it. Raises WireError."""
    start = PREFIX.size + LENGTH.size
    if len(message) < start:
        raise WireError(f"message has {len(message)} bytes, wanted at least {start}")
    magic, schema, wanted = PREFIX.unpack_from(message)
    if magic != MAGIC:
        raise WireError(f"message starts with {magic!r}, wanted {MAGIC!r}")
    if schema != SCHEMA_VERSION:
        raise WireError(
            f"message has schema version {schema}, wanted {SCHEMA_VERSION}: use one version of giirl on both sides"
        )
    body = memoryview(message)[PREFIX.size :]
    (length,) = LENGTH.unpack_from(body)
    _check_limits(length, 0, len(message), max_bytes)
    if (found := checksum(body)) != wanted:
        raise WireError(f"message is damaged: its checksum is {found:016x}, wanted {wanted:016x}")
    header, layout = _unpack_header(message[start : start + length])
    _check_limits(length, len(layout[0]), len(message), max_bytes)
    return header, _columns(layout, message, start + length + -length % ALIGN)


def encode_episode(episode: Episode, *, stamp: Stamp) -> bytes:
    """The message of one finished episode."""
    header = {
        "kind": "episode",
        "run": stamp.run,
        "actor": stamp.actor,
        "incarnation": stamp.incarnation,
        "sequence": stamp.sequence,
        **cols.header_fields(episode.trajectory),
        "raw_reward": float(episode.outcome.raw_reward),
        "ended": bool(episode.outcome.ended),
    }
    return encode(header, cols.pack([episode.trajectory]))


def decode_episode(message: bytes) -> tuple[Episode, Stamp]:
    """The inverse of `encode_episode`. Raises WireError."""
    header, arrays = decode(message)
    return build_episode(header, arrays), read_stamp(header)


def read_stamp(header: Header) -> Stamp:
    """The stamp of an actor's message, from its header. Raises WireError."""
    with as_wire_error():
        return Stamp(
            run=read_field(header, "run", str),
            actor=read_field(header, "actor", str),
            incarnation=read_field(header, "incarnation", int),
            sequence=read_field(header, "sequence", int),
        )


def build_episode(header: Header, arrays: Columns) -> Episode:
    """The episode of a decoded message. Raises WireError."""
    check_kind(header, "episode")
    with as_wire_error():
        reward = read_field(header, "raw_reward", float)
        if not math.isfinite(reward):
            raise WireError(f"header field 'raw_reward' is {reward}, wanted a finite number")
        (trajectory,) = cols.unpack(arrays, [header])
        return Episode(
            trajectory=trajectory, outcome=Outcome(raw_reward=reward, ended=read_field(header, "ended", bool))
        )


def write_episodes(path: Path, episodes: Sequence[Episode]) -> None:
    """Write an episode file, atomically: magic, number of episodes, then length and message of each."""
    with atomic_write(path) as file:
        file.write(FILE_MAGIC + COUNT.pack(len(episodes)))
        for number, episode in enumerate(episodes):
            message = encode_episode(episode, stamp=Stamp(run="", actor="", incarnation=0, sequence=number))
            file.writelines([COUNT.pack(len(message)), message])


def read_episodes(path: Path) -> list[Episode]:
    """The episodes of an episode file. Raises ValueError when the file is damaged or not an episode file."""
    episodes, damage = read_sound_episodes(path)
    if damage:
        raise ValueError(f"{path} is damaged at {damage[0]}; wanted a complete file")
    return episodes


def read_sound_episodes(path: Path) -> tuple[list[Episode], list[str]]:
    """The episodes of an episode file that can be read, and for each other one "episode NUMBER: what is wrong".

    What is missing at the end of a file that was cut off counts as one. ValueError when it is not an episode file.
    """
    data = path.read_bytes()
    if not data.startswith(FILE_MAGIC):
        raise ValueError(f"{path} is not an episode file: it starts with {data[:16]!r}, wanted {FILE_MAGIC!r}")
    episodes: list[Episode] = []
    damage: list[str] = []
    number = 0
    try:
        count, offset = _read_uint32(data, len(FILE_MAGIC))
        for number in range(count):
            size, offset = _read_uint32(data, offset)
            message, offset = _read_bytes(data, offset, size), offset + size
            try:
                episode, stamp = decode_episode(message)
                if stamp.sequence != number:
                    raise WireError(f"found episode number {stamp.sequence}, wanted {number}")
                episodes.append(episode)
            except WireError as error:
                damage.append(f"episode {number}: {error}")
        if offset != len(data):
            raise WireError(f"found {len(data) - offset} bytes after the last of {count} episodes")
    except WireError as error:
        damage.append(f"episode {number}: {error}")
    return episodes, damage


def check_kind(header: Header, kind: str) -> None:
    """Raise WireError when a message is of another kind."""
    if header.get("kind") != kind:
        raise WireError(f"message is of kind {header.get('kind')!r:.80}, wanted {kind!r}")


class as_wire_error:  # noqa: N801 - used like a function; a class, because a generator would be slower for each message
    """A context that turns ValueError into WireError, for values that are built from a received message."""

    def __enter__(self) -> None: ...

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ValueError) and not isinstance(error, WireError):
            raise WireError(str(error)) from error


def _check_limits(header_bytes: int, columns: int, size: int, max_bytes: int) -> None:
    if header_bytes > MAX_HEADER_BYTES or columns > MAX_COLUMNS or size > max_bytes:
        raise WireError(
            f"message with a header of {header_bytes} bytes, {columns} columns and {size} bytes in total is too big, "
            f"wanted at most {MAX_HEADER_BYTES}, {MAX_COLUMNS} and {max_bytes}"
        )


def _unpack_header(packed: bytes) -> tuple[Header, Layout]:
    try:
        # msgpack limits strings, lists and maps to the length of its input; binary and extension types are not allowed.
        content = msgpack.unpackb(packed, unicode_errors="surrogatepass", max_bin_len=0, max_ext_len=0)
    except (ValueError, msgpack.UnpackException) as error:
        raise WireError(f"header is not msgpack: {error}") from error
    match content:
        case [{"kind": str()} as header, list() as names, list() as dtypes, list() as shapes]:
            if set(map(type, header)) == {str} and len(names) == len(dtypes) == len(shapes):
                return header, (names, dtypes, shapes)
    raise WireError(f"header is {content!r:.80}, wanted fields with a kind, and names, dtypes and shapes of columns")


def _columns(layout: Layout, message: bytes, offset: int) -> Columns:
    """The columns of a message, from `offset` on.

    A message has dozens of columns, so this is optimised for valid ones: few checks here, the rest by numpy.
    """
    arrays: Columns = {}
    ndarray = np.ndarray
    for name, dtype_name, shape in zip(*layout, strict=True):
        try:
            dtype = DTYPES[dtype_name]
            if type(name) is not str or name in arrays or type(shape) is not list or len(shape) > MAX_DIMS:
                raise ValueError("its name is not unique or its shape is not valid")
            if shape == INFER_LENGTH:
                raise ValueError("its length is -1")
            array: Column = ndarray(shape, dtype, message, offset)
        except (TypeError, ValueError, KeyError) as error:
            column = f"column {name!r:.80} with dtype {dtype_name!r:.80} and shape {shape!r:.80}"
            raise WireError(f"{column} is not valid: {error}") from error
        size = array.nbytes
        if dtype is BOOLEAN and message[offset : offset + size].translate(None, b"\0\1"):
            raise WireError(f"column {name!r:.80} holds a byte above 1, wanted 0 (False) or 1 (True)")
        arrays[name] = array
        offset += size + -size % ALIGN
    if offset != len(message):
        raise WireError(f"message has {len(message)} bytes, but its columns end at byte {offset}")
    return arrays


def _read_uint32(data: bytes, offset: int) -> tuple[int, int]:
    return int.from_bytes(_read_bytes(data, offset, COUNT.size), "little"), offset + COUNT.size


def _read_bytes(data: bytes, offset: int, size: int) -> bytes:
    if offset + size > len(data):
        raise WireError(f"file has {len(data)} bytes, wanted at least {offset + size}")
    return data[offset : offset + size]
