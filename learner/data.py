"""Trajectories with their features beside them, and the ways to draw steps from many."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from giirl_core.nets.action_batch import ActionBatch, collate_actions, collate_sampled
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.features import Features, featurise
from giirl_core.nets.language import Vectors
from giirl_core.types import Action, Goal, Trajectory, Verb

WRONG_GOALS_KEPT = 4096  # features of expert pages under wrong goals that are kept


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A trajectory and what the nets see of each of its steps."""

    trajectory: Trajectory
    features: tuple[Features, ...]  # [T]


@dataclass(frozen=True, slots=True)
class Step:
    """One (s, a, g)."""

    features: Features
    action: Action


def featurise_trajectory(trajectory: Trajectory, vectors: Vectors) -> Example:
    """Compute the features once; an example is then used many times."""
    rows = tuple(featurise(page, trajectory.goal, vectors) for page in trajectory.pages)
    return Example(trajectory, rows)


def steps_of(examples: Sequence[Example]) -> list[Step]:
    """Every step of every example, in order."""
    return [
        Step(row, action)
        for example in examples
        for row, action in zip(example.features, example.trajectory.actions, strict=True)
    ]


def collate_steps(steps: Sequence[Step]) -> tuple[Batch, ActionBatch]:
    """Steps as tensors."""
    return collate([step.features for step in steps]), collate_actions([step.action for step in steps])


def sampled_of(examples: Sequence[Example]) -> tuple[ActionBatch, Tensor]:
    """The actions [sum T, M] sampled on every page of every example, and their log-probabilities then, nats."""
    return collate_sampled([example.trajectory for example in examples])


def carried_rewards(example: Example) -> Tensor:
    """[T, 1 + M] the rewards that a rollout brought along, of the action taken and of the sampled ones."""
    trajectory = example.trajectory
    taken = torch.from_numpy(np.array(trajectory.rewards)).unsqueeze(1)
    return taken if trajectory.sampled is None else torch.cat([taken, torch.tensor(trajectory.sampled.rewards)], dim=1)


class ExpertSampler:
    """D_E: expert trajectories with their goals, drawn evenly by task; and the same steps under wrong goals."""

    def __init__(self, demonstrations: Sequence[Trajectory], vectors: Vectors, rng: np.random.Generator) -> None:
        self._rng = rng
        self._featurise = functools.lru_cache(WRONG_GOALS_KEPT)(  # the same few pages meet the same few goals again
            lambda example, t, goal: featurise(example.trajectory.pages[t], goal, vectors)
        )
        self._of_task: dict[str, list[Example]] = {}
        for trajectory in demonstrations:
            self._of_task.setdefault(trajectory.task, []).append(featurise_trajectory(trajectory, vectors))
        self._tasks = sorted(self._of_task)
        # What experts do under each goal: doing it is not wrong there, so it is no negative.
        self._right: dict[tuple[str, str], set[tuple[Verb, str, str]]] = {}
        self._goals: dict[str, list[Goal]] = {}
        for task, examples in self._of_task.items():
            self._goals[task] = sorted({e.trajectory.goal for e in examples}, key=lambda goal: goal.utterance)
            for example in examples:
                right = self._right.setdefault((task, example.trajectory.goal.utterance), set())
                right |= {_signature(example.trajectory, t) for t in range(len(example.trajectory))}

    def sample(self, trajectories: int) -> list[Example]:
        """tau_E, g_E: every task equally likely, then every demonstration of it. ValueError when there is none."""
        if not self._tasks:
            raise ValueError("there are no demonstrations to learn from")
        drawn = []
        for _ in range(trajectories):
            examples = self._of_task[self._tasks[self._rng.integers(len(self._tasks))]]
            drawn.append(examples[self._rng.integers(len(examples))])
        return drawn

    def wrong_goals(self, examples: Sequence[Example]) -> list[Step]:
        """Expert steps under another goal of their task, where no expert does the same under that goal.

        Steps that are right whatever the goal (pressing Submit) and tasks with one goal give none.
        """
        wrong = []
        for example in examples:
            own, goals = example.trajectory, self._goals[example.trajectory.task]
            other = goals[self._rng.integers(len(goals))]
            t = int(self._rng.integers(len(own)))
            if other == own.goal or _signature(own, t) in self._right[(own.task, other.utterance)]:
                continue
            action = own.actions[t]
            start, end = other.find(action.text(own.goal)) if action.verb is Verb.TYPE else (-1, -1)
            row = self._featurise(example, t, other)
            wrong.append(Step(row, replace(action, start=start, end=end)))
        return wrong


def _signature(trajectory: Trajectory, t: int) -> tuple[Verb, str, str]:
    """An action apart from its page: verb, the element's text or tag, and what is typed."""
    page, action = trajectory.pages[t], trajectory.actions[t]
    return action.verb, page.text[action.element] or page.tag[action.element], action.text(trajectory.goal)


class Replay:
    """A bounded uniform sample of all trajectories so far (reservoir sampling, Vitter 1985)."""

    def __init__(self, size: int, rng: np.random.Generator) -> None:
        self.size, self._rng = size, rng
        self.examples: list[Example] = []
        self.seen = 0

    def add(self, examples: Sequence[Example]) -> None:
        for example in examples:
            self.seen += 1
            if len(self.examples) < self.size:
                self.examples.append(example)
            elif (place := int(self._rng.integers(self.seen))) < self.size:
                self.examples[place] = example

    def sample(self, count: int) -> list[Example]:
        """Trajectories drawn with replacement; none while empty."""
        if not self.examples:
            return []
        return [self.examples[i] for i in self._rng.integers(len(self.examples), size=count)]


def pick_step(example: Example, rng: np.random.Generator) -> Step:
    """One of its steps, all equally likely."""
    t = int(rng.integers(len(example.features)))
    return Step(example.features[t], example.trajectory.actions[t])


def last_step(example: Example, rng: np.random.Generator) -> Step:
    """Its last step: of an episode that succeeded, the one that reached the goal."""
    del rng
    return Step(example.features[-1], example.trajectory.actions[-1])


def pad(rows: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """[B, T] from B rows of different lengths, zeros past their ends."""
    table = np.zeros((len(rows), max(len(row) for row in rows)), dtype=np.float32)
    for b, row in enumerate(rows):
        table[b, : len(row)] = row
    return table
