"""The English instructions of LanguageGridCraft: which colour to go to and which to avoid, in many wordings."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gridcraft.layouts import COLOURS, colour_number

# No word names two colours. The first word of each colour is used in plain sentences.
SYNONYMS = {
    "red": ("red", "crimson", "scarlet", "ruby"),
    "green": ("green", "emerald", "lime", "jade"),
    "blue": ("blue", "azure", "navy", "sapphire"),
    "yellow": ("yellow", "gold", "amber", "lemon"),
}
PLAIN_TEMPLATE = "Go to {Goal}. Avoid {Avoid}."
TEMPLATES = (
    PLAIN_TEMPLATE,
    "Avoid {Avoid}. Go to {Goal}.",
    "Go to {goal} and avoid {avoid}.",
    "Avoid {avoid} and go to {goal}.",
    "Go to {goal}, but stay away from {avoid}.",
    "Stay away from {avoid} and walk to {goal}.",
    "Head for the {goal} region. Keep off the {avoid} one.",
    "Keep off {avoid} and head for {goal}.",
    "Reach {goal} without touching {avoid}.",
    "Without touching {avoid}, reach {goal}.",
    "Do not step on {avoid} on your way to {goal}.",
    "{Goal} is where to go, {avoid} is what to avoid.",
)


@dataclass(frozen=True, slots=True)
class ColourPair:
    """The meaning of an instruction: a colour to go to and a different colour to avoid."""

    goal: str
    avoid: str

    def __post_init__(self) -> None:
        for colour in (self.goal, self.avoid):
            colour_number(colour)
        if self.goal == self.avoid:
            raise ValueError(f"a pair got {self.goal!r} as both goal and avoid: wanted two colours")


def ordered_pairs(colours: tuple[str, ...] = COLOURS) -> tuple[ColourPair, ...]:
    """Every ordered pair of two different colours."""
    return tuple(ColourPair(goal, avoid) for goal, avoid in itertools.permutations(colours, 2))


def plain_sentence(pair: ColourPair) -> str:
    """The pair in the thesis's wording, "Go to Red. Avoid Blue."."""
    return _fill(PLAIN_TEMPLATE, pair.goal, pair.avoid)


def sentences(pair: ColourPair) -> tuple[str, ...]:
    """Every sentence with this meaning, the plain sentence first."""
    words = itertools.product(TEMPLATES, SYNONYMS[pair.goal], SYNONYMS[pair.avoid])
    return tuple(_fill(template, goal, avoid) for template, goal, avoid in words)


def sample_sentence(pair: ColourPair, rng: np.random.Generator) -> str:
    """A sentence with this meaning, sampled uniformly from `sentences`."""
    return str(rng.choice(sentences(pair)))


def rename_colours(sentence: str, names: Mapping[str, str]) -> str:
    """Replace each colour word by the matching word for the colour that `names` maps it to."""
    words = {old: new for a, b in names.items() for old, new in zip(SYNONYMS[a], SYNONYMS[b], strict=True)}

    def exchange(match: re.Match[str]) -> str:
        word = match.group()
        new = words.get(word.lower(), word.lower())
        return new.capitalize() if word[0].isupper() else new

    return re.sub(r"[A-Za-z]+", exchange, sentence)


def _fill(template: str, goal: str, avoid: str) -> str:
    return template.format(goal=goal, avoid=avoid, Goal=goal.capitalize(), Avoid=avoid.capitalize())
