"""Make giirl_core/nets/wordnet.tsv.gz from the database of WordNet 3.0 (Debian's package wordnet-base):

    python experiments/wordnet_words.py /usr/share/wordnet giirl_core/nets/wordnet.tsv.gz

A line has a word of the GloVe table and, separated by tabs, three lists of synonym sets: those that it is in, those
that these are similar to, and those that are more general than the first or that WordNet says to see also for any of
them. A set is a number that only says which words have it in common. An inflected word has the sets of its base forms
too. Words with no set that another word has are left out.
"""

from __future__ import annotations

import gzip
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path

from giirl_core.nets.language import GloVe

Set = tuple[str, str]  # part of speech, and place in the file
PARTS = {"noun": "n", "verb": "v", "adj": "a", "adv": "r"}
SIMILAR, MORE_GENERAL, SEE_ALSO = "&", "@", "^"  # pointers of data.*
SHORTEST = 3  # letters of a base form: shorter words are symbols (k, Re), which `king` and `red` do not come from
ENDINGS = (("ies", "y"), ("es", ""), ("es", "e"), ("s", ""), ("ed", ""), ("ed", "e"), ("ing", ""), ("ing", "e"))


class WordNet:
    """The synonym sets of each word, and the sets that a set points to."""

    def __init__(self, folder: Path) -> None:
        self.sets: dict[str, set[Set]] = defaultdict(set)  # of each word in lower case
        self.pointers: dict[str, dict[Set, set[Set]]] = defaultdict(lambda: defaultdict(set))  # by symbol
        self.irregular: dict[str, set[str]] = defaultdict(set)  # base forms
        for name, part in PARTS.items():
            for line in (folder / f"data.{name}").read_text(encoding="utf-8").splitlines():
                if not line.startswith("  "):
                    self._read(part, line.split("|")[0].split())
            for line in (folder / f"{name}.exc").read_text(encoding="utf-8").splitlines():
                inflected, *bases = line.split()
                self.irregular[inflected].update(bases)

    def _read(self, part: str, fields: list[str]) -> None:
        """A line of data.*: offset, file, type, number of words, (word, id) each, number of pointers, and these."""
        own, words = (part, fields[0]), int(fields[3], 16)
        for word in fields[4 : 4 + 2 * words : 2]:
            self.sets[re.sub(r"\(.*\)", "", word).lower()].add(own)
        first = 4 + 2 * words + 1
        for at in range(first, first + 4 * int(fields[first - 1]), 4):
            symbol, offset, kind = fields[at : at + 3]
            self.pointers[symbol][own].add(("a" if kind == "s" else kind, offset))

    def of(self, word: str) -> set[Set]:
        """The sets of a word and of what it may be an inflection of."""
        bases = {word.removesuffix(end) + new for end, new in ENDINGS if word.endswith(end)}
        bases = {word, *self.irregular.get(word, ()), *(base for base in bases if len(base) >= SHORTEST)}
        return {one for base in bases & self.sets.keys() for one in self.sets[base]}

    def follow(self, sets: Iterable[Set], symbol: str) -> set[Set]:
        """The sets that a pointer leads to."""
        return {other for one in sets for other in self.pointers[symbol].get(one, ())}


def main(folder: str, out: str) -> None:
    wordnet = WordNet(Path(folder))
    found: dict[str, tuple[set[Set], set[Set], set[Set]]] = {}
    for word in GloVe().words():
        if word.isalpha() and (own := wordnet.of(word)):
            similar = wordnet.follow(own, SIMILAR) - own
            near = own | similar
            related = (wordnet.follow(near, SEE_ALSO) | wordnet.follow(own, MORE_GENERAL)) - near
            found[word] = (own, similar, related)
    words = Counter(one for lists in found.values() for sets in lists for one in sets)
    number = {one: str(i) for i, (one, count) in enumerate(sorted(words.items())) if count > 1}
    rows = [
        "\t".join([word, *(" ".join(sorted(number[one] for one in sets if one in number)) for sets in lists)])
        for word, lists in sorted(found.items())
    ]
    data = "".join(row + "\n" for row in rows if row.split("\t", 1)[1].strip()).encode()
    Path(out).write_bytes(gzip.compress(data, mtime=0))


if __name__ == "__main__":
    main(*sys.argv[1:])
