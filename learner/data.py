"""Training data of the web learner: trajectories with their features, the demonstrations, and the replay buffer."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from giirl_core.choices import Choice
from giirl_core.gestures import BASIC, Gesture, Takes
from giirl_core.nets.action_batch import ActionBatch, collate_choices, collate_sampled
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.features import Features, featurise
from giirl_core.nets.language import Vectors
from giirl_core.types import NO_ELEMENT, Episode, Goal, Trajectory, Verb

PRIORITY_EXPONENT, IMPORTANCE_EXPONENT = 0.6, 0.4  # of prioritised replay
WRONG_GOAL_CACHE = 4096  # expert pages under wrong goals whose features are cached


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """A trajectory with the features of its T pages under its goal, and its actions as the nets choose them."""

    trajectory: Trajectory
    features: tuple[Features, ...]  # [T]
    choices: tuple[Choice, ...]  # [T]


@dataclass(frozen=True, slots=True)
class Step:
    """One (s, a, g): the features of a page under a goal, and the action."""

    features: Features
    choice: Choice


def featurise_trajectory(trajectory: Trajectory, vectors: Vectors, gestures: Sequence[Gesture] = BASIC) -> Example:
    """Compute the features of a trajectory, once for all its uses in training; ValueError for any other gesture."""
    rows = tuple(featurise(page, trajectory.goal, vectors) for page in trajectory.pages)
    return Example(trajectory, rows, tuple(trajectory.choices(gestures)))


def steps_of(examples: Sequence[Example]) -> list[Step]:
    """All steps of all examples, in order."""
    return [
        Step(row, choice) for example in examples for row, choice in zip(example.features, example.choices, strict=True)
    ]


def collate_steps(steps: Sequence[Step]) -> tuple[Batch, ActionBatch]:
    """B steps as tensors: the pages, and the actions [B, 1]."""
    return collate([step.features for step in steps]), collate_choices([step.choice for step in steps])


def sampled_actions_of(examples: Sequence[Example]) -> tuple[ActionBatch, Tensor]:
    """The sampled actions [sum T, M] of all examples, and their log-probabilities when they were sampled, nats.

    ValueError if the examples have different M.
    """
    return collate_sampled([example.trajectory for example in examples])


def carried_rewards(example: Example) -> Tensor:
    """[T, 1 + M] the rewards stored in a rollout: those of the actions taken, then those of the sampled actions."""
    trajectory = example.trajectory
    taken = torch.from_numpy(np.array(trajectory.rewards)).unsqueeze(1)
    return taken if trajectory.sampled is None else torch.cat([taken, torch.tensor(trajectory.sampled.rewards)], dim=1)


class ExpertSampler:
    """D_E, the demonstrations with their goals: samples trajectories, and expert steps under wrong goals."""

    def __init__(
        self,
        demonstrations: Sequence[Trajectory],
        vectors: Vectors,
        rng: np.random.Generator,
        gestures: Sequence[Gesture] = BASIC,
    ) -> None:
        self._rng, self._gestures = rng, gestures
        self._featurise = functools.lru_cache(WRONG_GOAL_CACHE)(  # few pages and few goals, so the pairs recur
            lambda example, t, goal: featurise(example.trajectory.pages[t], goal, vectors)
        )
        self._first = [featurise_trajectory(trajectory, vectors, gestures) for trajectory in demonstrations]
        self.join(())

    def join(self, further: Sequence[Example]) -> None:
        """D_E is now the demonstrations of the run and these further ones, in place of those of an earlier call."""
        self._examples: dict[str, list[Example]] = {}  # of each task
        for example in (*self._first, *further):
            self._examples.setdefault(example.trajectory.task, []).append(example)
        self._tasks = sorted(self._examples)
        self._goals: dict[str, list[Goal]] = {}  # of each task
        # What experts do under each (task, goal): such an action is correct there, so it is not used as a negative.
        self._expert_actions: dict[tuple[str, str], set[tuple[Verb, str, str]]] = {}
        for task, examples in self._examples.items():
            self._goals[task] = sorted({e.trajectory.goal for e in examples}, key=lambda goal: goal.utterance)
            for example in examples:
                signatures = self._expert_actions.setdefault((task, example.trajectory.goal.utterance), set())
                signatures |= {_signature(example.trajectory, t) for t in range(len(example.trajectory))}

    def sample(self, trajectories: int) -> list[Example]:
        """tau_E, g_E: `trajectories` demonstrations with replacement, uniform over tasks, then within the task.

        ValueError if there are no demonstrations.
        """
        if not self._tasks:
            raise ValueError("there are no demonstrations to learn from")
        sampled = []
        for _ in range(trajectories):
            examples = self._examples[self._tasks[self._rng.integers(len(self._tasks))]]
            sampled.append(examples[self._rng.integers(len(examples))])
        return sampled

    def wrong_goals(self, examples: Sequence[Example]) -> list[Step]:
        """Expert steps under another goal of their task, as negatives for the discriminator: at most one per example.

        Steps that an expert also takes under the other goal, such as pressing Submit, are left out, because they are
        correct there. A task with a single goal has none.
        """
        wrong = []
        for example in examples:
            own, goals = example.trajectory, self._goals[example.trajectory.task]
            other = goals[self._rng.integers(len(goals))]
            t = int(self._rng.integers(len(own)))
            if other == own.goal or _signature(own, t) in self._expert_actions[(own.task, other.utterance)]:
                continue
            wrong.append(self._under(example, t, other))
        return wrong

    def wrong_steps(self, examples: Sequence[Example]) -> list[Step]:
        """Expert steps made wrong by another step of their demonstration: at most one of each kind per example.

        - What another step types, in the field of this one.
        - The last action before its turn, on an earlier page that has its element.
        - The last action in its turn, under a goal that asks for other steps before: the page is not what it should be.

        They say what a demonstration alone does not: which words belong into which field, and when a task is done.
        """
        return [
            step
            for example in examples
            for step in (self._other_words(example), self._too_early(example), self._not_done(example))
            if step is not None
        ]

    def _other_words(self, example: Example) -> Step | None:
        own = example.trajectory
        typed = [t for t, choice in enumerate(example.choices) if self._gestures[choice.gesture].takes is Takes.WORDS]
        if len(typed) < 2:
            return None
        here, there = self._rng.choice(typed, 2, replace=False).tolist()
        if own.actions[here].text(own.goal) == own.actions[there].text(own.goal):
            return None
        other = example.choices[there]
        return Step(example.features[here], example.choices[here]._replace(start=other.start, end=other.end))

    def _too_early(self, example: Example) -> Step | None:
        own, last = example.trajectory, len(example.trajectory) - 1
        if not last or own.actions[last].element == NO_ELEMENT or own.actions[last].to != NO_ELEMENT:
            return None
        t = int(self._rng.integers(last))
        rows = np.flatnonzero(own.pages[t].ref == own.pages[last].ref[own.actions[last].element])
        if not len(rows) or _signature(own, last) in {_signature(own, k) for k in range(t, last)}:
            return None
        return Step(example.features[t], example.choices[last]._replace(element=int(rows[0])))

    def _not_done(self, example: Example) -> Step | None:
        own, last, goals = example.trajectory, len(example.trajectory) - 1, self._goals[example.trajectory.task]
        other = goals[self._rng.integers(len(goals))]
        right = self._expert_actions[own.task, other.utterance]
        if all(_signature(own, t) in right for t in range(last)):
            return None
        return self._under(example, last, other)

    def _under(self, example: Example, t: int, goal: Goal) -> Step:
        """A step of an example under another goal, where it types the same words if the goal has them."""
        own, choice = example.trajectory, example.choices[t]
        if self._gestures[choice.gesture].takes is Takes.WORDS:
            start, end = goal.find(own.actions[t].text(own.goal))
            choice = choice._replace(start=start, end=end)
        return Step(self._featurise(example, t, goal), choice)


def _signature(trajectory: Trajectory, t: int) -> tuple[Verb, str, str]:
    """The action of step t independent of its page: verb, text or tag of the element, typed text."""
    page, action = trajectory.pages[t], trajectory.actions[t]
    where = "" if action.element == NO_ELEMENT else page.text[action.element] or page.tag[action.element]
    return action.verb, where, action.text(trajectory.goal)


class Replay:
    """The replay buffer: a uniform sample of `size` of all trajectories added (reservoir sampling, Vitter 1985).

    `seen` is the number of trajectories added. Those with higher `priorities` can be sampled more often; new ones begin
    with the highest so far.
    """

    def __init__(self, size: int, rng: np.random.Generator) -> None:
        self.size, self._rng = size, rng
        self.examples: list[Example] = []
        self.priorities: list[float] = []  # of each example
        self.seen = 0

    def add(self, examples: Sequence[Example]) -> None:
        highest = max(self.priorities, default=1.0)
        for example in examples:
            self.seen += 1
            if len(self.examples) < self.size:
                self.examples.append(example)
                self.priorities.append(highest)
            elif (index := int(self._rng.integers(self.seen))) < self.size:
                self.examples[index], self.priorities[index] = example, highest

    def sample(self, count: int) -> list[Example]:
        """`count` trajectories, sampled with replacement; none from an empty buffer."""
        if not self.examples:
            return []
        return [self.examples[i] for i in self._rng.integers(len(self.examples), size=count)]

    def sample_by_priority(self, count: int) -> tuple[list[int], NDArray[np.float32]]:
        """`count` indices of trajectories, sampled with replacement by their priorities, and their importance weights.

        Prioritised experience replay (Schaul et al. 2016, eq. 1 and section 3.4); the largest weight is 1.
        """
        share = np.array(self.priorities) ** PRIORITY_EXPONENT
        share /= share.sum()
        chosen = self._rng.choice(len(share), size=count, p=share)
        weights = (len(share) * share[chosen]) ** -IMPORTANCE_EXPONENT
        return chosen.tolist(), (weights / weights.max()).astype(np.float32)


def random_step(example: Example, rng: np.random.Generator) -> Step:
    """One step of the example, uniformly at random."""
    t = int(rng.integers(len(example.features)))
    return Step(example.features[t], example.choices[t])


def last_step(example: Example, rng: np.random.Generator) -> Step:
    """The last step of the example; in a successful episode, the one that reached the goal. `rng` is not used."""
    del rng
    return Step(example.features[-1], example.choices[-1])


def pad_rows(rows: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
    """[B, T] B rows of different lengths as one table, padded with zeros at their ends."""
    table = np.zeros((len(rows), max(len(row) for row in rows)), dtype=np.float32)
    for b, row in enumerate(rows):
        table[b, : len(row)] = row
    return table


def with_env_reward(episode: Episode) -> Trajectory:
    """The trajectory with the sparse reward of the page, for the baselines that are trained on it.

    A failure has the reward 0, where MiniWoB gives -1. With -1 the first thing to learn is never to submit anything,
    because a discounted failure is better the later it comes.
    """
    rewards = np.zeros(len(episode.trajectory), dtype=np.float32)
    rewards[-1] = max(episode.outcome.raw_reward, 0.0)
    return replace(episode.trajectory, rewards=rewards)
