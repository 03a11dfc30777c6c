"""Files of human recordings: where they are, and their JSON, compressed or not."""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

MAX_BYTES = 64 << 20  # decompressed; the largest public recording has 5 MB
SUFFIXES = (".json.gz", ".json")
GZIP_MAGIC = b"\x1f\x8b"
STAND_INS = {  # first bytes of files that stand where a recording should be: what they are, and what to do
    b"version https://git-lfs": "is a pointer of Git LFS, wanted the file itself: git lfs pull",
    b"\x00\x05\x16\x07": "is a companion file of macOS, wanted the recording itself",
}


def find_recordings(root: Path, *, collections: Sequence[str] | None = None) -> dict[str, list[Path]]:
    """Map each task to its recordings, sorted by collection and file name. ValueError if there are none."""
    if not root.is_dir():
        raise ValueError(f"{root} is not a folder, wanted a folder with recordings as COLLECTION/TASK/*.json.gz")
    root = root.resolve()
    paths = [
        path
        for depth in ("*", "*/*", "*/*/*")
        for path in root.glob(depth)
        if path.name.endswith(SUFFIXES) and not path.is_dir()  # a broken link is a file that cannot be read
    ]
    existing = {path.parent.parent.name for path in paths}
    for name in collections or ():
        if name not in existing:
            raise ValueError(f"{root} has no collection {name!r}, wanted one of: {', '.join(sorted(existing))}")
    found: dict[str, list[Path]] = {}
    for path in sorted(paths):
        if collections is None or path.parent.parent.name in collections:
            found.setdefault(path.parent.name, []).append(path)
    if not found:
        raise ValueError(f"{root} has no recordings, wanted files COLLECTION/TASK/*.json.gz below it")
    return dict(sorted(found.items()))


def name_of(path: Path) -> str:
    """The file name without its suffix: the same for every copy of a recording."""
    return next(path.name.removesuffix(suffix) for suffix in SUFFIXES if path.name.endswith(suffix))


def read_json(path: Path) -> Any:
    """The content of a file. ValueError, without the path, if it cannot be read or is not JSON."""
    content = _read_bytes(path)
    if not content:
        raise ValueError("is an empty file, wanted a recorded episode")
    for start, what in STAND_INS.items():
        if content.startswith(start):
            raise ValueError(what)
    try:
        return json.loads(content, parse_constant=_refuse_constant)
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"not JSON ({error}), wanted a recorded episode") from error


def _read_bytes(path: Path) -> bytes:
    """The file's bytes, decompressed if they are gzip. The suffix is not reliable in the public recordings."""
    try:
        with path.open("rb") as file:
            compressed = file.read(2) == GZIP_MAGIC
            file.seek(0)
            if compressed:
                with gzip.GzipFile(fileobj=file) as inner:
                    content = inner.read(MAX_BYTES + 1)
            else:
                content = file.read(MAX_BYTES + 1)
    except EOFError as error:
        raise ValueError("the gzip data is truncated, wanted a complete file") from error
    except (gzip.BadGzipFile, zlib.error) as error:
        raise ValueError(f"the gzip data is damaged ({error}), wanted a complete file") from error
    except OSError as error:
        raise ValueError(f"cannot be read ({error.strerror}), wanted a file") from error
    if len(content) > MAX_BYTES:
        raise ValueError(f"contains more than {MAX_BYTES >> 20} MB, wanted one recorded episode")
    return content


def _refuse_constant(name: str) -> float:
    raise ValueError(f"contains {name}, wanted finite numbers")
