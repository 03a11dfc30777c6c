"""The wire contract: what episodes and weights look like as bytes, on a socket and in a file.

A message is a list of frames. The first is a fixed prefix (magic, schema version, XXH3 of all that follows)
and a msgpack header; each further frame is one column of raw little-endian numbers, which the header names
and measures. Whatever is wrong with a message is a WireError and nothing else; sizes are checked before
anything is allocated.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
from xxhash import xxh3_64

from giirl import columns as cols
from giirl.columns import Column, Columns, take
from giirl.files import whole_file
from giirl.spec import Episode, Outcome

SCHEMA = 3
MAGIC = b"GIRL"
PREFIX = struct.Struct("<4sHQ")  # magic, schema, checksum
MAX_BYTES = 64 << 20
MAX_HEADER_BYTES = 1 << 20
MAX_FRAMES = 64
MAX_DIMS = 4
DTYPES = {
    name: np.dtype(name) for name in ("|b1", "|i1", "|u1", "<i2", "<i4", "<i8", "<u2", "<u4", "<u8", "<f4", "<f8")
}
FILE_MAGIC = b"giirl episodes 2\n"
COUNT = struct.Struct("<I")

Header = dict[str, Any]


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
        if self.incarnation < 0 or self.sequence < 0:
            raise ValueError(f"incarnation {self.incarnation} and sequence {self.sequence} have to be 0 or more")


def encode(header: Mapping[str, object], arrays: Mapping[str, Column] | None = None) -> list[bytes]:
    """Frames of one message; `header` says its "kind"."""
    if not isinstance(header.get("kind"), str):
        raise ValueError(f"a header needs a kind, got {header.get('kind')!r}")
    layout, frames = [], []
    for name, array in (arrays or {}).items():
        dtype = array.dtype.str
        if dtype not in DTYPES:
            array = array.astype(array.dtype.newbyteorder("<"))
            dtype = array.dtype.str
            if dtype not in DTYPES:
                raise ValueError(f"column {name!r} is of type {array.dtype}, wanted one of {sorted(DTYPES)}")
        layout.append((name, dtype, array.shape))
        frames.append(array.tobytes())
    try:
        body = msgpack.packb([dict(header), layout], use_bin_type=True, unicode_errors="surrogatepass")
    except (TypeError, OverflowError) as error:
        raise ValueError(f"header of kind {header['kind']!r} cannot be packed: {error}") from error
    _check_limits([body, *frames], MAX_BYTES)
    return [PREFIX.pack(MAGIC, SCHEMA, checksum([body, *frames])) + body, *frames]


def decode(frames: Sequence[bytes], *, max_bytes: int = MAX_BYTES) -> tuple[Header, Columns]:
    """Header and columns of one message; the columns are read-only views of its frames."""
    if not frames or len(frames[0]) < PREFIX.size:
        raise WireError(f"a message of {len(frames)} frames has no whole header, wanted {PREFIX.size} bytes or more")
    magic, schema, promised = PREFIX.unpack_from(frames[0])
    if magic != MAGIC:
        raise WireError(f"a message starts with {magic!r}, wanted {MAGIC!r}")
    if schema != SCHEMA:
        raise WireError(f"a message has schema {schema}, this program speaks {SCHEMA}: use one version on both sides")
    parts = [frames[0][PREFIX.size :], *frames[1:]]
    _check_limits(parts, max_bytes)
    if (found := checksum(parts)) != promised:
        raise WireError(f"a message is damaged: checksum {found:016x}, wanted {promised:016x}")
    header, layout = _unpack_header(parts[0])
    if len(layout) != len(parts) - 1:
        raise WireError(f"a message has {len(parts) - 1} column frames, its header names {len(layout)}")
    arrays: Columns = {}
    with untrusted():
        for entry, frame in zip(layout, parts[1:], strict=True):
            name, array = _column(entry, frame)
            if name in arrays:
                raise WireError(f"column {name!r} comes twice")
            arrays[name] = array
    return header, arrays


def encode_episode(episode: Episode, *, stamp: Stamp) -> list[bytes]:
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


def decode_episode(frames: Sequence[bytes]) -> tuple[Episode, Stamp]:
    """The inverse of `encode_episode`."""
    header, arrays = decode(frames)
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
    with whole_file(path) as file:
        file.write(FILE_MAGIC + COUNT.pack(len(episodes)))
        for number, episode in enumerate(episodes):
            frames = encode_episode(episode, stamp=Stamp(run="", actor="", incarnation=0, sequence=number))
            sizes = [len(frame) for frame in frames]
            file.write(b"".join(map(COUNT.pack, [len(frames), *sizes])))
            file.writelines(frames)


def read_episodes(path: Path) -> list[Episode]:
    """The episodes of a file that `write_episodes` wrote."""
    data = path.read_bytes()
    if not data.startswith(FILE_MAGIC):
        raise ValueError(f"{path} is no episode file: it starts with {data[:16]!r}, wanted {FILE_MAGIC!r}")
    episodes: list[Episode] = []
    try:
        count, offset = _number(data, len(FILE_MAGIC))
        while offset < len(data):
            frames, offset = _record(data, offset)
            episode, stamp = decode_episode(frames)
            if stamp.sequence != len(episodes):
                raise WireError(f"episode {stamp.sequence} stands where {len(episodes)} should")
            episodes.append(episode)
        if len(episodes) != count:
            raise WireError(f"it holds {len(episodes)} episodes, its head promises {count}")
    except WireError as error:
        raise ValueError(f"{path} is damaged at episode {len(episodes)}: {error}; wanted a whole file") from error
    return episodes


def checksum(parts: Sequence[bytes]) -> int:
    """64 bits over all parts, whatever their borders: those the header tells."""
    digest = xxh3_64()
    for part in parts:
        digest.update(part)
    return digest.intdigest()


def expect(header: Header, kind: str) -> None:
    """Refuse a message of another kind."""
    if header.get("kind") != kind:
        raise WireError(f"a message is of kind {header.get('kind')!r:.80}, wanted {kind!r}")


@contextmanager
def untrusted() -> Iterator[None]:
    """Values are built here from what a peer sent: what the values refuse is the message's fault."""
    try:
        yield
    except WireError:
        raise
    except ValueError as error:
        raise WireError(str(error)) from error


def _check_limits(parts: Sequence[bytes], max_bytes: int) -> None:
    size = sum(map(len, parts))
    if len(parts) > MAX_FRAMES or len(parts[0]) > MAX_HEADER_BYTES or size > max_bytes:
        raise WireError(
            f"a message of {len(parts)} frames, {len(parts[0])} header bytes and {size} bytes in all "
            f"is too big: wanted {MAX_FRAMES}, {MAX_HEADER_BYTES} and {max_bytes} at most"
        )


def _unpack_header(body: bytes) -> tuple[Header, list[Any]]:
    try:
        # What the body's own length does not bound (strings, lists, maps) msgpack bounds by it.
        content = msgpack.unpackb(body, unicode_errors="surrogatepass", max_bin_len=0, max_ext_len=0)
    except (ValueError, msgpack.UnpackException) as error:
        raise WireError(f"a header is not msgpack: {error}") from error
    match content:
        case [{"kind": str(), **_rest} as header, list() as layout] if all(isinstance(key, str) for key in header):
            return header, layout
    raise WireError(f"a header is {content!r:.80}, wanted fields with a kind and a list of columns")


def _column(entry: Any, frame: bytes) -> tuple[str, Column]:
    """Every message has dozens of these, so what is as it should be passes few questions."""
    try:
        name, dtype, shape = entry
        kind = DTYPES[dtype]
        size = kind.itemsize * math.prod(shape)
        sound = type(name) is str and type(shape) is list and len(shape) <= MAX_DIMS
    except (TypeError, ValueError, KeyError):
        sound = False
    if not sound:
        raise WireError(f"a column is described as {entry!r:.80}, wanted name, type and shape")
    if not (len(shape) == 1 and type(shape[0]) is int and size >= 0) and not _is_shape(shape):
        raise WireError(f"column {name!r:.80} has shape {shape!r:.80}")
    if size != len(frame):
        raise WireError(f"column {name!r:.80} of shape {shape} and type {dtype} comes with {len(frame)} bytes")
    if dtype == "|b1" and frame.translate(None, b"\0\1"):
        raise WireError(f"column {name!r:.80} holds a byte above 1, wanted 0 for False and 1 for True")
    flat = np.frombuffer(frame, dtype=kind)
    return name, flat if len(shape) == 1 else flat.reshape(shape)


def _is_shape(shape: list[object]) -> bool:
    return all(type(length) is int and 0 <= length <= MAX_BYTES for length in shape)


def _number(data: bytes, offset: int) -> tuple[int, int]:
    return int.from_bytes(_piece(data, offset, COUNT.size), "little"), offset + COUNT.size


def _piece(data: bytes, offset: int, size: int) -> bytes:
    if offset + size > len(data):
        raise WireError(f"it ends after {len(data)} bytes, something in it reaches to {offset + size}")
    return data[offset : offset + size]


def _record(data: bytes, offset: int) -> tuple[list[bytes], int]:
    count, offset = _number(data, offset)
    sizes, frames = [], []
    for _ in range(min(count, MAX_FRAMES + 1)):  # one too many is refused as a message
        size, offset = _number(data, offset)
        sizes.append(size)
    for size in sizes:
        frames.append(_piece(data, offset, size))
        offset += size
    return frames, offset
