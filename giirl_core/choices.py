"""Choices: actions as the nets choose them, as rows of numbers."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from giirl_core.actions import NO_SPAN, Action, Verb
from giirl_core.gestures import BASIC, NOWHERE, TYPING, Gesture, Takes, allowed_elements
from giirl_core.pages import Page

MAX_LITERAL = 200  # characters of a text that is part of a gesture
MIN_SHOWN = 3  # demonstrations that have to show a gesture before the nets learn it
EDGE = 0.4  # a drag that begins and ends this far from the centre, in sizes of the element, is one across it
# Distances are rounded to these, so that gestures of a hand that differ little are one.
DISTANCES_PX = np.array([0, 1, 2, 5, 10, 15, 20, 25, 30, 40, 50, 60, 80, 100, 150, 200, 300, 500, 1000, 2000, 5000])

Kind = tuple[Verb, Takes, str, bool, bool, bool]


class Choice(NamedTuple):
    """An action as the nets choose it. `start` and `end` are goal tokens; `start` may also be a second element."""

    gesture: int  # number in the gestures of the run
    element: int
    start: int = NO_SPAN
    end: int = NO_SPAN


def choice_of(action: Action, page: Page, gestures: Sequence[Gesture]) -> Choice | None:
    """The choice that stands for an action on a page, that with the nearest distances; None if there is none."""
    element = 0 if action.verb is Verb.WAIT else action.element
    best: tuple[float, Choice] | None = None
    for gesture, second in _read(action, page):
        kind = _kind(gesture)
        for number, known in enumerate(gestures):
            if known.verb is not gesture.verb or _kind(known) != kind:
                continue
            distance = math.dist((*known.at, *known.by), (*action.at, *action.by))
            if best is None or distance < best[0]:
                start = action.start if gesture.takes is Takes.WORDS else second
                best = distance, Choice(number, element, start, action.end)
        if best is not None:
            return best[1]
    return None


def can_choose(choice: Choice, gesture: Gesture, page: Page) -> bool:
    """Whether a policy can make this choice: its gesture is allowed on the element, and words to type are there."""
    has_words = gesture.takes is not Takes.WORDS or choice.start != NO_SPAN
    return has_words and bool(allowed_elements(gesture, page)[choice.element])


def action_of(choice: Choice, page: Page, gestures: Sequence[Gesture]) -> Action:
    """The action on a page that a choice stands for."""
    gesture, element = gestures[choice.gesture], choice.element
    if gesture.verb is Verb.WAIT:
        return Action(verb=Verb.WAIT)
    action = Action(verb=gesture.verb, element=element, literal=gesture.literal, at=gesture.at, by=gesture.by)
    if gesture.takes is Takes.WORDS:
        return replace(action, start=choice.start, end=choice.end)
    if gesture.takes is Takes.TEXT_OF:
        return replace(action, literal=_text_of(page, choice.start))
    if gesture.takes is Takes.TO:
        return replace(action, to=choice.start)
    if gesture.across:
        width, height = np.maximum(page.box[element, 2:], 1.0).tolist()
        inset = min(1.0, height / 20)  # px, the element begins below its upper edge
        return replace(action, at=(-width / 2, inset - height / 2), by=(width, height - 2 * inset))
    return action


def shown_gestures(demonstrations: Iterable[Iterable[tuple[Action, Page]]]) -> tuple[str, ...]:
    """What demonstrations show besides the basic gestures, at least MIN_SHOWN of them, the most frequent first.

    Where no distance of a kind of gesture is that frequent but the kind is, its most frequent distance stands for it.
    """
    counts, kinds = Counter[Gesture](), Counter[Kind]()
    for steps in demonstrations:
        shown = {gesture for action, page in steps for gesture in readings(action, page)}
        counts.update(shown)
        kinds.update({_kind(gesture) for gesture in shown})
    found: list[Gesture] = []
    for gesture, count in sorted(counts.items(), key=lambda pair: (-pair[1], str(pair[0]))):
        is_first = _kind(gesture) not in map(_kind, found)
        if gesture not in BASIC and (count >= MIN_SHOWN or (is_first and kinds[_kind(gesture)] >= MIN_SHOWN)):
            found.append(gesture)
    return tuple(map(str, found))


def readings(action: Action, page: Page) -> list[Gesture]:
    """The gestures that an action can be seen as, best first; none for an action on no element."""
    return [gesture for gesture, _ in _read(action, page)]


def _kind(gesture: Gesture) -> Kind:
    """The gesture without its distances; in their place, whether there are any."""
    return gesture.verb, gesture.takes, gesture.literal, gesture.across, gesture.at != NOWHERE, gesture.by != NOWHERE


def _read(action: Action, page: Page) -> list[tuple[Gesture, int]]:
    """What an action can be seen as, best first: a gesture with rounded distances, and the second element or -1."""
    if action.verb is Verb.WAIT:
        return [(Gesture(verb=Verb.WAIT), NO_SPAN)]
    if action.element < 0:
        return []
    gesture = Gesture(verb=action.verb, literal=action.literal, at=_rounded(action.at), by=_rounded(action.by))
    if action.start != NO_SPAN or (action.verb in (Verb.TYPE, Verb.APPEND) and not action.literal):
        return [(replace(gesture, takes=Takes.WORDS), NO_SPAN)]  # without a span: words that the goal lacks
    if action.to >= 0:
        return [(replace(gesture, takes=Takes.TO), action.to)]
    if action.verb is Verb.DRAG and _is_across(action, page):
        return [(Gesture(verb=Verb.DRAG, across=True), NO_SPAN)]
    if action.verb in TYPING and action.literal:
        rows = sorted(range(len(page)), key=lambda row: row == action.element)
        source = next((row for row in rows if _text_of(page, row) == action.literal), NO_SPAN)
        copied = [(replace(gesture, takes=Takes.TEXT_OF, literal=""), source)] if source != NO_SPAN else []
        return copied + ([(gesture, NO_SPAN)] if len(action.literal) <= MAX_LITERAL else [])
    return [(gesture, NO_SPAN)]


def _text_of(page: Page, row: int) -> str:
    return page.value[row] or page.text[row] or " "  # something has to be typed


def _rounded(pair: tuple[float, float]) -> tuple[float, float]:
    if pair == NOWHERE:
        return pair
    x, y = (math.copysign(DISTANCES_PX[np.abs(DISTANCES_PX - abs(px)).argmin()], px) + 0.0 for px in pair)
    return x, y


def _is_across(action: Action, page: Page) -> bool:
    """Whether a drag selects an element: it begins near one corner and ends near the opposite one."""
    size = np.maximum(page.box[action.element, 2:], 1.0)
    begin, end = np.array(action.at) / size, (np.array(action.at) + action.by) / size
    return bool((begin <= -EDGE).all() and (end >= EDGE).all())


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledActions:
    """M actions per step of a trajectory that were sampled but not taken, with their rewards.

    Half of them are sampled from the policy, half from the random policy. ValueError if the shapes differ.
    """

    choices: NDArray[np.int16]  # [T, M, 4] the fields of Choice
    logp: NDArray[np.float32]  # [T, M] nats, log mu(a | s_t, g) under the acting policy, also of the random half
    rewards: NDArray[np.float32]  # [T, M] r(s_t, a | g) of the trajectory's reward_version; 0 while unscored

    def __post_init__(self) -> None:
        steps = self.choices.shape[:2]
        if self.choices.shape != (*steps, 4) or self.logp.shape != steps or self.rewards.shape != steps:
            raise ValueError(
                f"SampledActions.choices has shape {self.choices.shape}, .logp {self.logp.shape} and .rewards "
                f"{self.rewards.shape}, wanted [T, M, 4], [T, M] and [T, M]"
            )

    def check(self, elements: Sequence[int], words: int, gestures: Sequence[Gesture]) -> None:
        """ValueError unless every choice is one of `gestures`, with an element and words that exist.

        `elements` [T] is the number of elements on each page, `words` the number of tokens of the goal.
        """
        gesture, element, start, end = np.moveaxis(self.choices, 2, 0)
        count = np.array(elements)[:, None]
        known = (gesture >= 0) & (gesture < len(gestures)) & (element >= 0) & (element < count)
        number = np.where(known, gesture, 0)
        takes_words = np.array([one.takes is Takes.WORDS for one in gestures])[number]
        takes_second = np.array([one.has_second for one in gestures])[number]
        span = (start >= 0) & (start <= end) & (end < words)
        second = (start >= 0) & (start < count) & (end == NO_SPAN)
        nothing = (start == NO_SPAN) & (end == NO_SPAN)
        legal = known & np.where(takes_words, span, np.where(takes_second, second, nothing))
        if not legal.all():
            t, m = (int(index) for index in np.argwhere(~legal)[0])
            raise ValueError(
                f"sampled action {m} of step {t} is {self.choices[t, m].tolist()}, wanted one of {len(gestures)} "
                f"gestures on a page with {elements[t]} elements under a goal with {words} words"
            )
