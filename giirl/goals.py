"""Which goals training never sees, where a study asks what was learned about those."""

from __future__ import annotations

import re
import zlib

from giirl.spec import Goal

QUOTED = re.compile(r'"([^"]*)"')
PARTS = 10_000


def is_held_out(goal: Goal, share: float) -> bool:
    """True for about `share` of all goals, the same ones in every run.

    What is quoted in an instruction is its goal, whatever its case: a button's label, a person to type, a link.
    Without quotes it is the whole instruction.
    """
    names = QUOTED.findall(goal.utterance) or [goal.utterance]
    return zlib.crc32("\0".join(names).lower().encode()) % PARTS < share * PARTS
