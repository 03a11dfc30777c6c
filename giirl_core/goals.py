"""Held-out goals: goals that training never sees, so that an evaluation can measure generalisation to them."""

from __future__ import annotations

import re
import zlib

from giirl_core.types import Goal

QUOTED = re.compile(r'"([^"]*)"')
WORD = re.compile(r"\w+")
SALT = "unseen"  # chosen so that no word is held out that another instruction of the same study has outside quotes
BUCKETS = 10_000


def is_held_out(goal: Goal, fraction: float) -> bool:
    """True for about `fraction` of all goals, the same ones in every run.

    The decision is a hash of the goal's quoted strings (a button's label, a name to type, a link); of the whole
    utterance when nothing is quoted. Only the words matter, not their case nor the punctuation between them.
    """
    quoted = QUOTED.findall(goal.utterance) or [goal.utterance]
    words = WORD.findall(" ".join(quoted).lower())
    return zlib.crc32(" ".join([SALT, *words]).encode()) % BUCKETS < fraction * BUCKETS
