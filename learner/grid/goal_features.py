"""Instructions as counts of words: goal features of the tabular chapter."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import TOKEN


class BagOfWords:
    """Counts over a closed vocabulary, the goal features of the thesis's tabular chapter (section 3.4).

    With `order=2` pairs of neighbouring words are counted too, since a plain bag cannot tell
    "Go to red. Avoid blue." from "Go to blue. Avoid red.".
    """

    def __init__(self, utterances: Iterable[str], order: int = 1) -> None:
        self.order = order
        terms = {term for utterance in utterances for term in self._terms(utterance)}
        self.column = {term: i for i, term in enumerate(sorted(terms))}

    def __call__(self, utterance: str) -> NDArray[np.float32]:
        """[V] counts; words outside the vocabulary are left out."""
        bag = np.zeros(len(self.column), dtype=np.float32)
        for term in self._terms(utterance):
            if term in self.column:
                bag[self.column[term]] += 1.0
        return bag

    def _terms(self, utterance: str) -> Sequence[str]:
        words = [m.group() for m in TOKEN.finditer(utterance.lower()) if m.group().isalnum()]
        return [" ".join(words[i : i + n]) for n in range(1, self.order + 1) for i in range(len(words) - n + 1)]
