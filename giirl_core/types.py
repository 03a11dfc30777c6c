"""The value types that all packages share: episodes, pages, observations, commands, trajectories."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from giirl_core.actions import NO_ELEMENT, NO_SPAN, TOKEN, VERB_FIELDS, Action, Goal, Verb, is_held_out
from giirl_core.choices import Choice, SampledActions, can_choose, choice_of, readings
from giirl_core.gestures import Gesture
from giirl_core.pages import TYPABLE_TAGS, Page

__all__ = [
    "DEMONSTRATION",
    "NO_ELEMENT",
    "NO_REF",
    "NO_SPAN",
    "TOKEN",
    "TYPABLE_TAGS",
    "UNSCORED",
    "VERB_FIELDS",
    "Action",
    "Browser",
    "Command",
    "Episode",
    "EpisodeSpec",
    "Goal",
    "Observation",
    "Outcome",
    "Page",
    "Purpose",
    "SampledActions",
    "StepResult",
    "Trajectory",
    "Verb",
    "is_held_out",
    "page_seed",
]

NO_REF = 0  # Command.ref, .to: no element
UNSCORED = -1  # Trajectory.reward_version: not scored yet
DEMONSTRATION = -1  # Trajectory.policy_version: recorded from a demonstrator, not from a policy


class Purpose(IntEnum):
    """What an episode is played for. Each purpose has its own range of page seeds, so purposes share no pages."""

    TRAIN = 1
    DEMONSTRATE = 2
    EVALUATE = 3
    INSPECT = 4
    RANDOM = 5
    FEEDBACK = 6


def page_seed(purpose: Purpose, run_seed: int, index: int) -> int:
    """The seed of the index-th page of a run for a purpose; below 2**53, so that JavaScript represents it exactly.

    Distinct (purpose, run_seed, index) give distinct seeds: they take 4, 16 and 32 bits. Raises ValueError when
    `run_seed` or `index` does not fit.
    """
    if not 0 <= run_seed < 1 << 16:
        raise ValueError(f"run seed {run_seed} is out of range: wanted 0 to {(1 << 16) - 1}")
    if not 0 <= index < 1 << 32:
        raise ValueError(f"episode index {index} is out of range: wanted 0 to {(1 << 32) - 1}")
    return int(purpose) << 48 | run_seed << 32 | index


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSpec:
    """Which page to open: a task, and the seed that determines its instruction and its DOM."""

    task: str
    seed: int
    mode: str = "train"  # or "test": a few MiniWoB tasks reserve some instructions for it


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """What the policy observes: a page and the goal of the episode."""

    episode: EpisodeSpec
    page: Page
    goal: Goal
    step: int = 0  # of the episode: the number of actions taken before


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One step of one browser tab: an action, and the episode to open when this one ends.

    The fields of the action are those of `Action`, with browser handles (`Page.ref`) in place of rows.
    """

    verb: Verb
    ref: int = NO_REF  # Page.ref of the element, 0 for none
    text: str = ""  # the text to type, or the key to press
    at: tuple[float, float] = (0.0, 0.0)  # CSS px
    by: tuple[float, float] = (0.0, 0.0)  # CSS px
    to: int = NO_REF  # Page.ref of the element where a DRAG ends
    last: bool = False  # step limit reached: end the episode even if the page does not
    following: EpisodeSpec | None = None  # the next episode of the tab; None leaves it idle

    @classmethod
    def of(
        cls, action: Action, observation: Observation, *, last: bool = False, following: EpisodeSpec | None = None
    ) -> Command:
        """The command that carries out `action` on the observed page."""
        refs = observation.page.ref
        return cls(
            verb=action.verb,
            ref=int(refs[action.element]) if action.element >= 0 else NO_REF,
            text=action.text(observation.goal),
            at=action.at,
            by=action.by,
            to=int(refs[action.to]) if action.to >= 0 else NO_REF,
            last=last,
            following=following,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StepResult:
    """The result of one command.

    When the episode ended (`done`, `lost`, or `last` in the command), the observation is the next episode's first.
    """

    raw_reward: float  # the page's reward, not scaled by time; 0 until the episode ends
    done: bool  # the page ended the episode
    observation: Observation | None  # None only when no episode follows
    lost: str = ""  # why the infrastructure aborted the episode, "" when it did not
    reason: str = ""  # the page's explanation of the reward, "" when it gives none
    scaled_reward: float | None = None  # raw_reward scaled by the time that was left; None in virtual time


class Browser(Protocol):
    """K browser tabs, each with one episode at a time. `reset` opens episodes and `step` acts, in many tabs at once.

    Keys are tab numbers from 0 to `tabs` - 1. An episode whose page does not open is void: its observation is missing,
    and `unopened` says why until the next call. `screenshot` returns a PNG of an area (left, top, width, height in CSS
    px), or b"" from a browser without screenshots. The loop of an actor:

        observations = browser.reset({tab: next_episode() for tab in range(browser.tabs)})
        while True:
            commands = {tab: Command.of(act(o), o, following=next_episode()) for tab, o in observations.items()}
            observations = {tab: result.observation for tab, result in browser.step(commands).items()}
    """

    tabs: int

    @property
    def unopened(self) -> Mapping[int, str]: ...

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]: ...

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]: ...

    def screenshot(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """One episode of T steps as the learner sees it: goal, states, actions, rewards; not whether it succeeded.

    Demonstrations are trajectories too. Raises ValueError when the columns have different lengths, or an action
    refers to an element or a token that does not exist.
    """

    task: str
    goal: Goal
    seed: int
    pages: tuple[Page, ...]  # [T] states
    actions: tuple[Action, ...]  # [T]
    behaviour_logp: NDArray[np.float32]  # [T] nats, log mu(a_t | s_t, g) when the action was taken
    rewards: NDArray[np.float32]  # [T] r(s_t, a_t | g) of reward_version; zeros while unscored
    policy_version: int  # oldest learner step that produced mu; -1 marks a demonstration
    reward_version: int = UNSCORED  # learner step of the reward that scored it
    sampled: SampledActions | None = None  # None without sampled actions

    def __post_init__(self) -> None:
        steps, tokens = len(self.pages), len(self.goal.tokens)
        if steps == 0:
            raise ValueError("Trajectory.pages is empty, wanted at least one step")
        for name in ("actions", "behaviour_logp", "rewards"):
            if len(getattr(self, name)) != steps:
                raise ValueError(f"Trajectory.{name} has {len(getattr(self, name))} steps, .pages has {steps}")
        if self.sampled is not None and len(self.sampled.choices) != steps:
            raise ValueError(f"Trajectory.sampled has {len(self.sampled.choices)} steps, .pages has {steps}")
        for t, (page, action) in enumerate(zip(self.pages, self.actions, strict=True)):
            if max(action.element, action.to) >= len(page):
                raise ValueError(f"step {t} acts on element {max(action.element, action.to)}, its page has {len(page)}")
            if action.end >= tokens:
                raise ValueError(f"step {t} types tokens {action.start}..{action.end}, the goal has {tokens}")

    def __len__(self) -> int:
        return len(self.pages)

    @property
    def reward_count(self) -> int:
        """Number of rewards to compute: one for each action taken and each sampled action."""
        return self.rewards.size + (self.sampled.rewards.size if self.sampled is not None else 0)

    def with_rewards(self, rewards: NDArray[np.float32], version: int) -> Trajectory:
        """The trajectory with `rewards` [T * (1 + M)] of one version: per step, action taken, then sampled ones."""
        table = rewards.reshape(len(self), -1)
        sampled = self.sampled if self.sampled is None else replace(self.sampled, rewards=table[:, 1:])
        return replace(self, rewards=table[:, 0], sampled=sampled, reward_version=version)

    def unlearnable(self, gestures: Sequence[Gesture] | None = None) -> str:
        """Which action a policy with these gestures cannot choose, or, with None, no policy can; "" if it can all."""
        for t, (action, page) in enumerate(zip(self.actions, self.pages, strict=True)):
            known = readings(action, page) if gestures is None else gestures
            choice = choice_of(action, page, known)
            if choice is None or not can_choose(choice, known[choice.gesture], page):
                return self._no_gesture(t)
        return ""

    def choices(self, gestures: Sequence[Gesture]) -> list[Choice]:
        """[T] the actions as choices; ValueError when an action, taken or sampled, is none of the gestures of a run."""
        found = []
        for t, (action, page) in enumerate(zip(self.actions, self.pages, strict=True)):
            choice = choice_of(action, page, gestures)
            if choice is None:
                raise ValueError(self._no_gesture(t))
            found.append(choice)
        if self.sampled is not None:
            self.sampled.check([len(page) for page in self.pages], len(self.goal.tokens), gestures)
        return found

    def _no_gesture(self, t: int) -> str:
        action = self.actions[t]
        return (
            f"{self.task} with seed {self.seed}, step {t} is {action.verb.name} {action.literal!r:.40} on element "
            f"{action.element}: no gesture that the nets learn (net.gestures)"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """The environment's verdict on an episode: for reports, never for training."""

    raw_reward: float
    ended: bool  # False when the step limit truncated the episode

    @property
    def success(self) -> bool:
        """True only for the full reward: some pages give partial credit."""
        return self.raw_reward == 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """One finished episode: the trajectory to learn from, and the outcome to report."""

    trajectory: Trajectory
    outcome: Outcome
