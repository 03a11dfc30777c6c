"""Which goals training never sees, where a study asks what was learned about those."""

from __future__ import annotations

import re
import zlib

from giirl_core.types import Goal

QUOTED = re.compile(r'"([^"]*)"')
WORD = re.compile(r"\w+")
DRAW = "unseen"  # by this one no word is held out that another instruction of the same study says outside quotes
PARTS = 10_000


def is_held_out(goal: Goal, share: float) -> bool:
    """True for about `share` of all goals, the same ones in every run.

    What is quoted in an instruction is its goal: a button's label, a person to type, a link. Without quotes it is
    the whole instruction. Its words count, not their case or the punctuation between.
    """
    names = QUOTED.findall(goal.utterance) or [goal.utterance]
    words = WORD.findall(" ".join(names).lower())
    return zlib.crc32(" ".join([DRAW, *words]).encode()) % PARTS < share * PARTS
