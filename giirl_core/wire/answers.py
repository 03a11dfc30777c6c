"""Answers of people about episodes, and their files: `giirl feedback` writes them, the learner reads them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote

import numpy as np

from giirl_core.files import atomic_write
from giirl_core.types import DEMONSTRATION, NO_SPAN, UNSCORED, Goal, Trajectory
from giirl_core.wire import columns as cols
from giirl_core.wire.messages import MAX_BYTES, WireError, as_wire_error, check_kind, decode, encode

SUFFIX = ".answer"
RIGHT = -1  # Answer.wrong_from of an episode that is right


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a person says of one episode. It holds no verdict of the page.

    Raises ValueError for a step that does not exist, for corrections of an episode that is right, and for an
    instruction that lacks words which the episode types.
    """

    episode: Trajectory  # as the policy played it
    wrong_from: int = RIGHT  # the step from which on it is wrong; RIGHT: no step is
    right_for: Goal | None = None  # the instruction under which it would have been right
    shown: Trajectory | None = None  # the right way, as the person played it

    def __post_init__(self) -> None:
        if not RIGHT <= self.wrong_from < len(self.episode):
            raise ValueError(f"step {self.wrong_from} is marked as wrong, the episode has {len(self.episode)} steps")
        if self.wrong_from == RIGHT and (self.right_for is not None or self.shown is not None):
            raise ValueError("an episode that is right needs neither another instruction nor another way")
        if self.shown is not None and self.shown.task != self.episode.task:
            raise ValueError(f"the way shown is of {self.shown.task!r}, the episode of {self.episode.task!r}")
        _ = self.demonstrations  # an instruction that lacks words is an error

    @property
    def demonstrations(self) -> list[Trajectory]:
        """What joins the demonstrations: the episode if it is right, else its relabelled copy and the way shown."""
        found = [self.episode] if self.wrong_from == RIGHT else []
        if self.right_for is not None:
            found.append(relabel(self.episode, self.right_for))
        if self.shown is not None:
            found.append(self.shown)
        return [as_demonstration(trajectory) for trajectory in found]

    @property
    def wrong_steps(self) -> range:
        """The steps of the episode that join the negatives: all from the marked one on."""
        return range(0) if self.wrong_from == RIGHT else range(self.wrong_from, len(self.episode))

    @property
    def file_name(self) -> str:
        """One name for each page, so a page that is answered twice has one answer, the last."""
        return file_name(self.episode.task, self.episode.seed)


def file_name(task: str, seed: int) -> str:
    """The name of the file with the answer about one page."""
    return f"{quote(task, safe='')}-{seed}{SUFFIX}"


def relabel(trajectory: Trajectory, goal: Goal) -> Trajectory:
    """The trajectory under another goal; ValueError if it types words that the goal lacks."""
    actions = []
    for t, action in enumerate(trajectory.actions, start=1):
        if action.start != NO_SPAN:
            start, end = goal.find(text := action.text(trajectory.goal))
            if start == NO_SPAN:
                raise ValueError(f"step {t} types “{text}”: wanted an instruction with these words")
            action = replace(action, start=start, end=end)
        actions.append(action)
    return replace(trajectory, goal=goal, actions=tuple(actions), sampled=None)


def as_demonstration(trajectory: Trajectory) -> Trajectory:
    """The trajectory without what only rollouts of a policy have: log-probabilities, rewards, sampled actions."""
    zeros = np.zeros(len(trajectory), dtype=np.float32)
    return replace(
        trajectory,
        behaviour_logp=zeros,
        rewards=zeros,
        sampled=None,
        policy_version=DEMONSTRATION,
        reward_version=UNSCORED,
    )


def encode_answer(answer: Answer) -> bytes:
    """The message of one answer."""
    trajectories = [answer.episode, *([answer.shown] if answer.shown is not None else [])]
    header = {
        "kind": "answer",
        "episodes": [cols.header_fields(trajectory) for trajectory in trajectories],
        "wrong_from": answer.wrong_from,
        "right_for": answer.right_for.utterance if answer.right_for is not None else "",
    }
    return encode(header, cols.pack(trajectories))


def decode_answer(message: bytes) -> Answer:
    """The inverse of `encode_answer`. Raises WireError."""
    header, arrays = decode(message)
    check_kind(header, "answer")
    with as_wire_error():
        episodes, goal = cols.read_field(header, "episodes", list), cols.read_field(header, "right_for", str)
        if not (1 <= len(episodes) <= 2 and all(isinstance(one, dict) for one in episodes)):
            raise WireError(f"header field 'episodes' is {episodes!r:.80}, wanted one episode or two")
        episode, *shown = cols.unpack(arrays, episodes)
        return Answer(
            episode=episode,
            wrong_from=cols.read_field(header, "wrong_from", int),
            right_for=Goal(goal) if goal else None,
            shown=shown[0] if shown else None,
        )


def write_answer(folder: Path, answer: Answer) -> Path:
    """Write an answer into a folder, atomically; it replaces an earlier one about the same page. Returns its path."""
    path = folder / answer.file_name
    with atomic_write(path) as file:
        file.write(encode_answer(answer))
    return path


def read_answer(path: Path) -> Answer:
    """The answer in a file; ValueError, one line, if it is damaged or no answer."""
    try:
        if (size := path.stat().st_size) > MAX_BYTES:
            raise WireError(f"the file has {size} bytes, wanted at most {MAX_BYTES}")
        return decode_answer(path.read_bytes())
    except WireError as error:
        raise ValueError(f"{path} is no answer, or it is damaged: {error}") from None
