"""The file with the key pair of a run's learner: it stays the same when the run is resumed."""

from __future__ import annotations

from pathlib import Path

from giirl_core.files import atomic_write
from giirl_core.wire.transport import Keys


def load_or_create_keys(path: Path) -> Keys:
    """The pair in `path`; if there is no such file, a new pair is written to it, readable by the owner only.

    Raises ValueError when the file does not hold a pair.
    """
    if not path.exists():
        generated = Keys.generate()
        with atomic_write(path, mode=0o600) as file:
            file.write(generated.public + b"\n" + generated.secret + b"\n")
    lines = path.read_bytes().split()
    if len(lines) != 2:
        raise ValueError(f"{path} has {len(lines)} keys, wanted a public key and its secret key")
    return Keys(public=lines[0], secret=lines[1])
