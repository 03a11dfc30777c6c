"""What a policy and a learned reward make of one page under one instruction: a number for every element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from giirl_core.config import Config
from giirl_core.nets.reward import RewardModel, reward_of
from giirl_core.types import NO_SPAN, Action, Goal, Outcome, Page, Verb

NAMES = {"input_text": "text field", "input_password": "password field", "textarea": "text area", "t": "text"}
LONGEST_NAME = 40  # characters of an element's text that are quoted


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredAction:
    """An action and what the reward pays for it."""

    action: Action
    reward: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredPage:
    """One page under one instruction."""

    goal: Goal
    choice: Action | None  # the policy's; None where nothing can be done
    best: tuple[
        ScoredAction, ...
    ]  # for each element that can be acted upon, the action that earns the most; () of no reward

    @property
    def top(self) -> ScoredAction | None:
        """The best of all."""
        return max(self.best, key=lambda one: one.reward, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One step of an episode, under its own instruction and under another."""

    page: Page
    picture: bytes | None  # PNG of the page's `window_of`; None of a browser that draws nothing
    own: ScoredPage
    other: ScoredPage | None  # None where no other instruction fits the page


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeView:
    """One episode, or the first step of one."""

    task: str
    seed: int
    frames: tuple[Frame, ...]
    outcome: Outcome | None = None  # None where the episode was not played to its end
    trouble: str = ""  # why it could not be


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """The rewards that a run can give; -1 stands for the lowest, 0 for what D = 1/2 earns, 1 for the highest."""

    low: float
    middle: float
    high: float

    def share(self, reward: float) -> float:
        """Where a reward lies, from -1 to 1."""
        side = self.high - self.middle if reward > self.middle else self.middle - self.low
        return float(np.clip((reward - self.middle) / side, -1, 1)) if side else 0.0


def scale_of(config: Config) -> Scale:
    """The ends and the middle of the reward's form."""
    form, clip = config.discriminator.reward, config.discriminator.clip
    low, middle, high = reward_of(torch.tensor([-clip, 0.0, clip]), form, clip).tolist()
    return Scale(low=low, middle=middle, high=high)


def value_elements(model: RewardModel, page: Page, goal: Goal) -> tuple[ScoredAction, ...]:
    """For each element the better of clicking it and, in a field, typing any words of the instruction."""
    actions = [action for row in range(len(page)) for action in _options(page, goal, row)]
    if not actions:
        return ()
    best: dict[int, ScoredAction] = {}
    for action, reward in zip(actions, model.score_actions(page, goal, actions).tolist(), strict=True):
        if action.element not in best or reward > best[action.element].reward:
            best[action.element] = ScoredAction(action=action, reward=reward)
    return tuple(best.values())


def _options(page: Page, goal: Goal, row: int) -> list[Action]:
    options = [Action(verb=Verb.CLICK, element=row)] if page.leaf[row] else []
    if page.typable[row]:
        words = range(len(goal.tokens))
        spans = [(start, end) for start in words for end in words if start <= end]
        options += [Action(verb=Verb.TYPE, element=row, start=start, end=end) for start, end in spans]
    return options


def element_name(page: Page, row: int) -> str:
    """An element in words: its kind and what it reads."""
    kind, text = NAMES.get(page.tag[row], page.tag[row].replace("_", " ")), page.text[row] or page.value[row]
    return f"{kind} “{shortened(text)}”" if text else kind


def action_words(page: Page, goal: Goal, action: Action) -> str:
    """An action in words."""
    where = element_name(page, action.element)
    if action.verb is not Verb.TYPE:
        return f"{Verb(action.verb).name.lower()} {where}"
    text = action.text(goal) if action.start != NO_SPAN else "…"
    return f"type “{shortened(text)}” into {where}"


def shortened(text: str) -> str:
    """At most LONGEST_NAME letters of it."""
    return text if len(text) <= LONGEST_NAME else text[: LONGEST_NAME - 1] + "…"


def ranked(best: Sequence[ScoredAction]) -> list[ScoredAction]:
    """The highest reward first; in document order where rewards are equal."""
    return sorted(best, key=lambda one: -one.reward)
