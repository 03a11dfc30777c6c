"""Goal features for LanguageGridCraft: bag-of-words counts of an instruction."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from giirl_core.types import TOKEN


class BagOfWords:
    """Word counts over a fixed vocabulary (Luo 2019, section 3.4).

    With `ngram_order=2` bigrams are counted too: single words cannot distinguish "Go to red. Avoid blue." from
    "Go to blue. Avoid red.".
    """

    def __init__(self, utterances: Iterable[str], ngram_order: int = 1) -> None:
        self.ngram_order = ngram_order
        terms = {term for utterance in utterances for term in self._terms(utterance)}
        self.column = {term: i for i, term in enumerate(sorted(terms))}

    def __call__(self, utterance: str) -> NDArray[np.float32]:
        """[V] counts; terms outside the vocabulary are ignored."""
        bag = np.zeros(len(self.column), dtype=np.float32)
        for term in self._terms(utterance):
            if term in self.column:
                bag[self.column[term]] += 1.0
        return bag

    def _terms(self, utterance: str) -> Sequence[str]:
        words = [m.group() for m in TOKEN.finditer(utterance.lower()) if m.group().isalnum()]
        return [" ".join(words[i : i + n]) for n in range(1, self.ngram_order + 1) for i in range(len(words) - n + 1)]
