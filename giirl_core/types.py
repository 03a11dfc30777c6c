"""The values that every part of the system speaks in: pages, goals, actions, trajectories, weights."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from giirl_core.actions import LEARNED, NO_ELEMENT, NO_SPAN, TOKEN, USES, Action, Goal, Verb

__all__ = [
    "DEMONSTRATION",
    "LEARNED",
    "NO_ELEMENT",
    "NO_REF",
    "NO_SPAN",
    "TOKEN",
    "TYPABLE_TAGS",
    "UNSCORED",
    "USES",
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
    "StepResult",
    "Trajectory",
    "Verb",
    "Weights",
    "page_seed",
]

TYPABLE_TAGS = frozenset(
    {
        "input_text",
        "input_password",
        "input_email",
        "input_search",
        "input_number",
        "input_date",
        "input_time",
        "textarea",
    }
)
NO_REF = 0  # Command.ref, .to: none of the page's elements
UNSCORED = -1
DEMONSTRATION = -1


class Purpose(IntEnum):
    """What an episode is for. Every purpose has seeds of its own, so none can meet another's page."""

    TRAIN = 1
    DEMONSTRATE = 2
    EVALUATE = 3
    INSPECT = 4
    RANDOM_BASELINE = 5


def page_seed(purpose: Purpose, run_seed: int, index: int) -> int:
    """The seed of the index-th page of one run and purpose; below 2**53, so JavaScript keeps it exact.

    Distinct (purpose, run_seed, index) give distinct seeds: 4 bits, 16 bits and 32 bits.
    """
    if not 0 <= run_seed < 1 << 16:
        raise ValueError(f"run seed {run_seed} is out of range: wanted 0 to {(1 << 16) - 1}")
    if not 0 <= index < 1 << 32:
        raise ValueError(f"episode index {index} is out of range: wanted 0 to {(1 << 32) - 1}")
    return int(purpose) << 48 | run_seed << 32 | index


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSpec:
    """Which page to open: a task and the seed that fixes its instruction and its DOM."""

    task: str
    seed: int
    mode: str = "train"  # or "test": a few tasks keep some of their instructions for it


@dataclass(frozen=True, slots=True, kw_only=True)
class Page:
    """What a page shows at one moment: a table with one row for each visible element, in document order."""

    tag: tuple[str, ...]  # [E] lower case; inputs as "input_text"; "t" is a run of bare text
    text: tuple[str, ...]  # [E] text of a leaf, "" elsewhere
    value: tuple[str, ...]  # [E] what a field holds, "" elsewhere
    classes: tuple[str, ...]  # [E] space-separated
    ref: NDArray[np.int32]  # [E] the browser's handle on the element
    parent: NDArray[np.int16]  # [E] row of the parent, -1 for a root
    box: NDArray[np.float32]  # [E, 4] left, top, width, height in CSS px
    focused: NDArray[np.bool_]  # [E]
    tampered: NDArray[np.bool_]  # [E] acted upon in this episode
    colour: tuple[str, ...] = ()  # [E] what a drawing is filled with, or an element's own style; "" elsewhere
    shape: tuple[str, ...] = ()  # [E] kind of a drawing and its corners in px, "triangle 10,40 20,20 30,40"

    def __post_init__(self) -> None:
        rows = len(self.tag)
        for name in ("colour", "shape"):  # most pages draw nothing: () stands for a column of ""
            object.__setattr__(self, name, getattr(self, name) or ("",) * rows)
        for name in ("text", "value", "classes", "ref", "parent", "box", "focused", "tampered", "colour", "shape"):
            if len(getattr(self, name)) != rows:
                raise ValueError(f"Page.{name} has {len(getattr(self, name))} rows, Page.tag has {rows}")
        if self.box.shape != (rows, 4):
            raise ValueError(f"Page.box has shape {self.box.shape}, wanted {(rows, 4)}")
        if not bool(np.all((self.parent >= -1) & (self.parent < np.arange(rows)))):
            raise ValueError("Page.parent names a row that is not before its child; wanted document order, or -1")

    def __len__(self) -> int:
        return len(self.tag)

    @property
    def leaf(self) -> NDArray[np.bool_]:
        """[E] True where no other row is a child: what may be clicked."""
        leaf = np.ones(len(self.tag), dtype=np.bool_)
        leaf[self.parent[self.parent >= 0]] = False
        return leaf

    def below(self, row: int) -> list[int]:
        """Every row that is part of this one, in document order."""
        inside = {row}
        for later in range(row + 1, len(self.tag)):
            if int(self.parent[later]) in inside:
                inside.add(later)
        return sorted(inside - {row})

    @property
    def typable(self) -> NDArray[np.bool_]:
        """[E] True for fields that take text."""
        return np.array([tag in TYPABLE_TAGS for tag in self.tag], dtype=np.bool_)


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """A page and the instruction that came with it."""

    episode: EpisodeSpec
    page: Page
    goal: Goal


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One step of one tab: act, then go on to another episode when this one is over. Fields as in Action."""

    verb: Verb
    ref: int = NO_REF  # Page.ref of the element, 0 for none
    text: str = ""  # what to type, or the key to press
    at: tuple[float, float] = (0.0, 0.0)  # CSS px
    by: tuple[float, float] = (0.0, 0.0)  # CSS px
    to: int = NO_REF  # Page.ref of where a DRAG ends
    last: bool = False  # the step limit: end the episode even if the page does not
    following: EpisodeSpec | None = None  # what to open next; None leaves the tab idle

    @classmethod
    def of(
        cls, action: Action, seen: Observation, *, last: bool = False, following: EpisodeSpec | None = None
    ) -> Command:
        """An action on what was seen, in the browser's words."""
        refs = seen.page.ref
        return cls(
            verb=action.verb,
            ref=int(refs[action.element]) if action.element >= 0 else NO_REF,
            text=action.text(seen.goal),
            at=action.at,
            by=action.by,
            to=int(refs[action.to]) if action.to >= 0 else NO_REF,
            last=last,
            following=following,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StepResult:
    """What came of a command. When `done`, `lost` or the command's `last`, the observation is the next episode's."""

    raw_reward: float  # the page's own, not scaled by time; 0 while it runs
    done: bool  # the page ended the episode
    observation: Observation | None  # None only where no episode follows
    lost: str = ""  # why the episode broke off through no doing of the policy, "" if it did not
    reason: str = ""  # for the reward, where the page gives one


class Browser(Protocol):
    """K tabs, each showing one episode at a time. `reset` opens, `step` acts; both answer for many tabs at once.

    `picture` is a PNG of left, top, width and height in CSS px; b"" from a browser that draws none.
    """

    tabs: int

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]: ...

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]: ...

    def picture(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes: ...

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """What the learner trains on: states, actions and goal of one episode. It does not know whether it succeeded."""

    task: str
    goal: Goal
    seed: int
    pages: tuple[Page, ...]  # [T] what the policy saw
    actions: tuple[Action, ...]  # [T] what it did
    behaviour_logp: NDArray[np.float32]  # [T] nats, log mu(a_t | s_t, g) when the action was taken
    rewards: NDArray[np.float32]  # [T] r(s_t, a_t | g) of reward_version; zeros while unscored
    policy_version: int  # oldest learner step that produced mu; -1 marks a demonstration
    reward_version: int = UNSCORED  # learner step of the reward that scored it

    def __post_init__(self) -> None:
        steps = len(self.pages)
        if steps == 0:
            raise ValueError("a trajectory needs at least one step")
        for name in ("actions", "behaviour_logp", "rewards"):
            if len(getattr(self, name)) != steps:
                raise ValueError(f"Trajectory.{name} has {len(getattr(self, name))} steps, .pages has {steps}")
        for t, (page, action) in enumerate(zip(self.pages, self.actions, strict=True)):
            if max(action.element, action.to) >= len(page):
                raise ValueError(
                    f"step {t} acts on element {max(action.element, action.to)} of a page with {len(page)}"
                )
            if action.end >= len(self.goal.tokens):
                raise ValueError(
                    f"step {t} copies words {action.start}..{action.end} of a goal with {len(self.goal.tokens)}"
                )

    def __len__(self) -> int:
        return len(self.pages)

    def check_learned(self) -> None:
        """ValueError when a step is more than the nets can express."""
        for t, action in enumerate(self.actions):
            if not action.learned:
                raise ValueError(
                    f"{self.task} with seed {self.seed}, step {t} is {action.verb.name} {action.literal!r:.40} on row "
                    f"{action.element}: the nets learn only clicks on rows and typing words of the goal"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How an episode ended by the page's own reckoning: for reports, never for training."""

    raw_reward: float
    ended: bool  # False when our step limit cut it off

    @property
    def success(self) -> bool:
        """Nothing less than full reward counts (some pages give partial credit)."""
        return self.raw_reward == 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Episode:
    """One finished episode: what to learn from, and what to report."""

    trajectory: Trajectory
    outcome: Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class Weights:
    """A net's parameters at one learner step, as safetensors bytes with their checksum."""

    version: int  # learner step
    blob: bytes
    digest: str  # sha256 of blob, hex

    @classmethod
    def seal(cls, version: int, blob: bytes) -> Weights:
        return cls(version=version, blob=blob, digest=hashlib.sha256(blob).hexdigest())

    def check(self) -> None:
        """Raise ValueError when the blob is not the one that was sealed."""
        found = hashlib.sha256(self.blob).hexdigest()
        if found != self.digest:
            raise ValueError(
                f"weights version {self.version} are corrupt: sha256 {found[:12]}, wanted {self.digest[:12]}"
            )
