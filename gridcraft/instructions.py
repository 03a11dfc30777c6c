"""What LanguageGridCraft is asked in English: a colour to go to and one to avoid, in many words and orders."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gridcraft.layouts import COLOURS, colour_number

# No word names two colours. The first of each is the plain one.
SYNONYMS = {
    "red": ("red", "crimson", "scarlet", "ruby"),
    "green": ("green", "emerald", "lime", "jade"),
    "blue": ("blue", "azure", "navy", "sapphire"),
    "yellow": ("yellow", "gold", "amber", "lemon"),
}
PLAIN = "Go to {Goal}. Avoid {Avoid}."
FORMS = (
    PLAIN,
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
class Pair:
    """What an instruction means: the colour to go to and the colour to avoid."""

    goal: str
    avoid: str

    def __post_init__(self) -> None:
        for colour in (self.goal, self.avoid):
            colour_number(colour)
        if self.goal == self.avoid:
            raise ValueError(f"a pair got {self.goal!r} as goal and as what to avoid: wanted two colours")


def ordered_pairs(colours: tuple[str, ...] = COLOURS) -> tuple[Pair, ...]:
    """Every pair of two of these colours, both ways round."""
    return tuple(Pair(goal, avoid) for goal, avoid in itertools.permutations(colours, 2))


def plain_sentence(pair: Pair) -> str:
    """The thesis's own form, "Go to Red. Avoid Blue."."""
    return _fill(PLAIN, pair.goal, pair.avoid)


def sentences(pair: Pair) -> tuple[str, ...]:
    """Everything that says this pair, the plain sentence first."""
    words = itertools.product(FORMS, SYNONYMS[pair.goal], SYNONYMS[pair.avoid])
    return tuple(_fill(form, goal, avoid) for form, goal, avoid in words)


def draw_sentence(pair: Pair, rng: np.random.Generator) -> str:
    """One of the sentences that say this pair, all alike likely."""
    return str(rng.choice(sentences(pair)))


def rename(sentence: str, names: Mapping[str, str]) -> str:
    """The sentence with each word for a colour exchanged for a word for the colour that `names` gives."""
    words = {old: new for a, b in names.items() for old, new in zip(SYNONYMS[a], SYNONYMS[b], strict=True)}

    def exchange(match: re.Match[str]) -> str:
        word = match.group()
        new = words.get(word.lower(), word.lower())
        return new.capitalize() if word[0].isupper() else new

    return re.sub(r"[A-Za-z]+", exchange, sentence)


def _fill(form: str, goal: str, avoid: str) -> str:
    return form.format(goal=goal, avoid=avoid, Goal=goal.capitalize(), Avoid=avoid.capitalize())
