"""The policy's action and the learned reward of every element, for one page under one instruction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from giirl_core.choices import Choice, action_of
from giirl_core.config import Config
from giirl_core.gestures import TYPING, Gesture, Takes, allowed_elements
from giirl_core.nets.reward import RewardModel, reward_of
from giirl_core.types import NO_SPAN, Action, Goal, Outcome, Page, Verb

TAG_NAMES = {"input_text": "text field", "input_password": "password field", "textarea": "text area", "t": "text"}
MAX_QUOTE_CHARS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredAction:
    """An action and its learned reward."""

    action: Action
    reward: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredPage:
    """One page under one instruction."""

    goal: Goal
    policy_action: Action | None  # None where the page has no legal action
    best: tuple[ScoredAction, ...]  # the highest-reward action on each element; empty without a learned reward
    policy_logp: float = 0.0  # nats, log-probability of `policy_action`
    policy_reward: float | None = None  # of `policy_action`; None without a learned reward

    @property
    def top(self) -> ScoredAction | None:
        """The action with the highest reward on the page; None without a learned reward."""
        return max(self.best, key=lambda one: one.reward, default=None)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One step of an episode, under the page's own instruction and under another one."""

    page: Page
    screenshot: bytes | None  # PNG of the page's `visible_area`; None if the browser has no screenshots
    own: ScoredPage
    other: ScoredPage | None  # None where no other instruction fits the page


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeView:
    """One episode, or only its first step."""

    task: str
    seed: int
    frames: tuple[Frame, ...]
    outcome: Outcome | None = None  # None if the episode did not finish
    error: str = ""  # why it did not finish


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """The range of a reward form: its lowest value, its value at D = 1/2, and its highest value."""

    low: float
    middle: float
    high: float

    def normalise(self, reward: float) -> float:
        """Map a reward to [-1, 1]: -1 is `low`, 0 is `middle`, 1 is `high`."""
        width = self.high - self.middle if reward > self.middle else self.middle - self.low
        return float(np.clip((reward - self.middle) / width, -1, 1)) if width else 0.0


def scale_of(config: Config) -> Scale:
    """The range of the reward form that the config sets."""
    form, clip = config.discriminator.reward, config.discriminator.clip
    low, middle, high = reward_of(torch.tensor([-clip, 0.0, clip]), form, clip).tolist()
    return Scale(low=low, middle=middle, high=high)


def score_elements(
    model: RewardModel, page: Page, goal: Goal, taken: Action | None = None
) -> tuple[tuple[ScoredAction, ...], float | None]:
    """The highest-reward action on each element, among `element_actions`, and the reward of the action `taken`."""
    actions = element_actions(page, goal, model.net.gestures)
    asked = actions if taken is None else [*actions, taken]
    if not asked:
        return (), None
    rewards = model.score_actions(page, goal, asked).tolist()
    best: dict[int, ScoredAction] = {}
    for action, reward in zip(actions, rewards[: len(actions)], strict=True):
        if action.element not in best or reward > best[action.element].reward:
            best[action.element] = ScoredAction(action=action, reward=reward)
    return tuple(best.values()), None if taken is None else rewards[-1]


def element_actions(page: Page, goal: Goal, gestures: Sequence[Gesture]) -> list[Action]:
    """Every action on a page that the nets know, but those with a second element, of which there are too many."""
    words = range(len(goal.tokens))
    spans = [(start, end) for start in words for end in words if start <= end]
    found = []
    allowed = [allowed_elements(gesture, page) for gesture in gestures]
    for row in range(len(page)):
        for number, gesture in enumerate(gestures):
            if gesture.has_second or not allowed[number][row]:
                continue
            own = spans if gesture.takes is Takes.WORDS else [(NO_SPAN, NO_SPAN)]
            found += [action_of(Choice(number, row, start, end), page, gestures) for start, end in own]
    return found


def element_name(page: Page, row: int) -> str:
    """A description of an element: its kind and its text."""
    kind, text = TAG_NAMES.get(page.tag[row], page.tag[row].replace("_", " ")), page.text[row] or page.value[row]
    return f"{kind} “{truncate(text)}”" if text else kind


def describe_action(page: Page, goal: Goal, action: Action) -> str:
    """A description of an action, such as `click button “Ok”`."""
    where = element_name(page, action.element) if action.element >= 0 else "page"
    text = action.text(goal) or "…"
    if action.verb is Verb.PRESS:
        return f"press {text} in {where}"
    if action.verb in TYPING and (action.verb is not Verb.ACTIVATE or action.text(goal)):
        return f"{action.verb.name.lower()} “{truncate(text)}” into {where}"
    end = f" to {element_name(page, action.to)}" if action.to >= 0 else ""
    by = f" by {action.by[0]:.0f}, {action.by[1]:.0f} px" if any(action.by) else ""
    return f"{action.verb.name.lower().replace('_', ' ')} {where}{end}{by}"


def truncate(text: str) -> str:
    """At most MAX_QUOTE_CHARS characters of the text, with an ellipsis where it is cut."""
    return text if len(text) <= MAX_QUOTE_CHARS else text[: MAX_QUOTE_CHARS - 1] + "…"


def by_reward(best: Sequence[ScoredAction]) -> list[ScoredAction]:
    """Sort by reward, highest first; equal rewards stay in document order."""
    return sorted(best, key=lambda one: -one.reward)
