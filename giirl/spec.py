"""The values that every part of the system speaks in: pages, goals, actions, trajectories, weights."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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
NO_SPAN = -1
UNSCORED = -1
DEMONSTRATION = -1


class Verb(IntEnum):
    """What an action does to its element."""

    CLICK = 0
    TYPE = 1


class Purpose(IntEnum):
    """What an episode is for. Every purpose has seeds of its own, so none can meet another's page."""

    TRAIN = 1
    DEMONSTRATE = 2
    EVALUATE = 3
    INSPECT = 4
    FLOOR = 5


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

    def __post_init__(self) -> None:
        rows = len(self.tag)
        for name in ("text", "value", "classes", "ref", "parent", "box", "focused", "tampered"):
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

    @property
    def typable(self) -> NDArray[np.bool_]:
        """[E] True for fields that take text."""
        return np.array([tag in TYPABLE_TAGS for tag in self.tag], dtype=np.bool_)


TOKEN = re.compile(r"\w+|[^\w\s]")


@dataclass(frozen=True, slots=True)
class Goal:
    """An instruction in English, cut into words and single punctuation marks; case is kept."""

    utterance: str
    tokens: tuple[str, ...] = field(init=False, compare=False)  # [L]
    offsets: tuple[tuple[int, int], ...] = field(init=False, compare=False)  # [L] characters, end excluded

    def __post_init__(self) -> None:
        matches = list(TOKEN.finditer(self.utterance))
        if not matches:
            raise ValueError(f"a goal needs at least one word, got {self.utterance!r}")
        object.__setattr__(self, "tokens", tuple(m.group() for m in matches))
        object.__setattr__(self, "offsets", tuple(m.span() for m in matches))

    def span(self, start: int, end: int) -> str:
        """The instruction's own characters from token `start` to token `end`, both included."""
        return self.utterance[self.offsets[start][0] : self.offsets[end][1]]

    def find(self, text: str) -> tuple[int, int]:
        """The first token span that reads exactly `text`, preferring one in quotes; (-1, -1) when there is none."""
        wanted = tuple(m.group() for m in TOKEN.finditer(text))
        spans = [
            (start, start + len(wanted) - 1)
            for start in range(len(self.tokens) - len(wanted) + 1)
            if wanted and self.tokens[start : start + len(wanted)] == wanted
        ]
        spans = [span for span in spans if self.span(*span) == text]
        quoted = [span for span in spans if self.tokens[span[0] - 1 : span[0]] == ('"',)]
        return (quoted or spans or [(NO_SPAN, NO_SPAN)])[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Action:
    """What the policy chose: a verb, a row of the page, and for TYPE the words of the goal to copy."""

    verb: Verb
    element: int  # row of the page
    start: int = NO_SPAN  # token of the goal, -1 where nothing is typed or the text is not in the goal
    end: int = NO_SPAN  # token of the goal, included

    def text(self, goal: Goal) -> str:
        """The text to type, "" for a click."""
        return goal.span(self.start, self.end) if self.verb is Verb.TYPE and self.start >= 0 else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Observation:
    """A page and the instruction that came with it."""

    episode: EpisodeSpec
    page: Page
    goal: Goal


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One step of one tab: act, then go on to another episode when this one is over."""

    verb: Verb
    ref: int  # Page.ref of the element
    text: str = ""  # what to type
    last: bool = False  # the step limit: end the episode even if the page does not
    following: EpisodeSpec | None = None  # what to open next; None leaves the tab idle


@dataclass(frozen=True, slots=True, kw_only=True)
class StepResult:
    """What came of a command. When `done`, `lost` or the command's `last`, the observation is the next episode's."""

    raw_reward: float  # the page's own, not scaled by time; 0 while it runs
    done: bool  # the page ended the episode
    observation: Observation | None  # None only where no episode follows
    lost: str = ""  # why the episode broke off through no doing of the policy, "" if it did not


class Browser(Protocol):
    """K tabs, each showing one episode at a time. `reset` opens, `step` acts; both answer for many tabs at once."""

    tabs: int

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]: ...

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]: ...

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
            if not 0 <= action.element < len(page):
                raise ValueError(f"step {t} acts on element {action.element} of a page with {len(page)}")
            none = action.start == action.end == NO_SPAN
            if not none and not 0 <= action.start <= action.end < len(self.goal.tokens):
                raise ValueError(
                    f"step {t} copies words {action.start}..{action.end} of a goal with {len(self.goal.tokens)}"
                )

    def __len__(self) -> int:
        return len(self.pages)


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


class TrajectorySource(Protocol):
    """Where Algorithm 1 gets its rollouts from."""

    def take(self, episodes: int) -> list[Trajectory]: ...
