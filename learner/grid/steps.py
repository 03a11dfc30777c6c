"""Training data of LanguageGridCraft: steps of the expert, of the policy and of the random policy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import safetensors.numpy
import torch
from numpy.typing import NDArray

from gridcraft.instructions import ColourPair
from gridcraft.planning import Trajectories, random_policy, sample_trajectories, solve
from gridcraft.world import HORIZON, World, sample_starts, step, true_reward
from learner.grid.nets import STAY, GridFeatures, QNet

Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """N steps, each under a sentence. States, actions and sentences are stored as indices."""

    state: Index  # [N]
    action: Index  # [N]
    following: Index  # [N] next state
    goal: Index  # [N] sentence

    def __len__(self) -> int:
        return len(self.state)

    def pick(self, index: Index) -> Steps:
        """The steps at [M] indices."""
        return Steps(
            state=self.state[index],
            action=self.action[index],
            following=self.following[index],
            goal=self.goal[index],
        )

    def sample(self, count: int, rng: np.random.Generator) -> Steps:
        """`count` steps sampled with replacement; no steps if there are none."""
        return self.pick(rng.integers(len(self), size=count if len(self) else 0))

    def with_goals(self, goal: Index) -> Steps:
        """The same steps under the sentences [N]."""
        return Steps(state=self.state, action=self.action, following=self.following, goal=goal)

    @classmethod
    def join(cls, parts: Sequence[Steps]) -> Steps:
        """Concatenate several sets of steps."""
        return cls(
            state=np.concatenate([part.state for part in parts]),
            action=np.concatenate([part.action for part in parts]),
            following=np.concatenate([part.following for part in parts]),
            goal=np.concatenate([part.goal for part in parts]),
        )

    @classmethod
    def from_trajectories(cls, played: Trajectories, goal: Index, end_state: int | None) -> Steps:
        """The steps of N episodes of T steps under sentences [N].

        With `end_state`, the last action of each episode leads there, and one more step stays there.
        """
        states, actions = played.states, played.actions
        if end_state is not None:
            ends = np.full((len(states), 1), end_state)
            states = np.concatenate([states[:, :-1], ends, ends], axis=1)
            actions = np.concatenate([actions, np.full_like(ends, STAY)], axis=1)
        return cls(
            state=states[:, :-1].ravel(),
            action=actions.ravel(),
            following=states[:, 1:].ravel(),
            goal=np.repeat(goal, actions.shape[1]),
        )

    def to_bytes(self) -> bytes:
        """Serialise as safetensors."""
        blob: bytes = safetensors.numpy.save({name: getattr(self, name) for name in COLUMNS})
        return blob

    @classmethod
    def from_bytes(cls, blob: bytes) -> Steps:
        """The inverse of `to_bytes`."""
        return cls(**safetensors.numpy.load(blob))


EXPERT_TEMPERATURE = 0.1  # of the soft-optimal policy that gives the demonstrations
COLUMNS = tuple(field.name for field in fields(Steps))
NO_STEPS = Steps(**{name: np.zeros(0, dtype=np.int64) for name in COLUMNS})


def expert_steps(
    world: World,
    pairs: Sequence[ColourPair],
    sentences: Sequence[Sequence[int]],
    count: int,
    temperature: float,
    rng: np.random.Generator,
    end_state: int | None,
) -> Steps:
    """`count` demonstrations of each pair in each layout, from soft value iteration on the true reward.

    `sentences[i]` are the indices of the sentences that mean pairs[i]; each demonstration gets one of them at random.
    """
    parts = []
    for pair, candidates in zip(pairs, sentences, strict=True):
        pi = solve(world, true_reward(world, pair), temperature=temperature).pi
        for number in range(len(world.layouts)):
            start = np.where(world.layout == number, world.start, 0.0)
            starts = rng.choice(len(world), size=count, p=start / start.sum())
            goal = rng.choice(np.array(candidates), size=count)
            parts.append(Steps.from_trajectories(sample_trajectories(world, pi, starts, rng), goal, end_state))
    return Steps.join(parts)


def random_steps(
    world: World, goals: Sequence[int], count: int, rng: np.random.Generator, end_state: int | None
) -> Steps:
    """`count` episodes of the random policy, each under a random sentence of `goals`."""
    played = sample_trajectories(world, random_policy(world), sample_starts(world, count, rng), rng)
    return Steps.from_trajectories(played, rng.choice(np.array(goals), size=count), end_state)


class GridDemos:
    """D_E: the expert's episodes, and its steps under sentences with another meaning.

    `length` is the number of steps per episode, `pair_index` [G] the meaning of each sentence, and `goals` the
    sentences that training may use.
    """

    def __init__(self, steps: Steps, length: int, pair_index: Index, goals: Index, rng: np.random.Generator) -> None:
        self.steps, self._length, self._rng = steps, length, rng
        self._other_goals = {p: goals[pair_index[goals] != p] for p in set(pair_index[goals].tolist())}
        self._pair_index = pair_index
        states = max(steps.state.max(), steps.following.max()) + 1
        self._visited = np.zeros((pair_index.max() + 1, states), dtype=np.bool_)  # [pairs, S] by the expert
        self._visited[pair_index[steps.goal], steps.state] = True

    def sample(self, count: int) -> Steps:
        """`count` whole episodes, sampled with replacement."""
        episodes = self._rng.integers(len(self.steps) // self._length, size=count)
        return self.steps.pick((episodes[:, None] * self._length + np.arange(self._length)).ravel())

    def wrong_goals(self, expert: Steps) -> Steps:
        """The expert's steps under random sentences with another meaning, as negatives for the discriminator.

        Steps in states that the expert visits under the new sentence are left out, because they may be correct
        there. The remaining steps teach where to go and, for sentences with the same goal, what to avoid.
        """
        if len(self._other_goals) < 2:
            return NO_STEPS
        goal = np.zeros_like(expert.goal)
        for pair, others in self._other_goals.items():
            own = self._pair_index[expert.goal] == pair
            goal[own] = self._rng.choice(others, size=int(own.sum()))
        return expert.with_goals(goal).pick(np.flatnonzero(~self._visited[self._pair_index[goal], expert.state]))


class GridSource:
    """Plays the policy under random sentences of `goals`. `env_steps` counts the steps it has played."""

    def __init__(self, world: World, features: GridFeatures, goals: Index, net: QNet, rng: np.random.Generator) -> None:
        self.world, self._features, self._goals, self._net, self._rng = world, features, goals, net, rng
        self._end_state = features.end_state if features.absorbing else None
        self.env_steps = 0

    @torch.no_grad()
    def take(self, episodes: int) -> Steps:
        """Play `episodes` episodes of HORIZON steps."""
        goal = self._rng.choice(self._goals, size=episodes)
        states, actions = [sample_starts(self.world, episodes, self._rng)], []
        for _ in range(HORIZON):
            pi = self._net.log_policy(self._features.policy_inputs(states[-1], goal)).exp().numpy()
            below = np.cumsum(pi, axis=1)[:, :-1] <= self._rng.random((episodes, 1))
            actions.append(below.sum(axis=1))
            states.append(step(self.world, states[-1], actions[-1], self._rng))
        self.env_steps += episodes * HORIZON
        played = Trajectories(states=np.stack(states, axis=1), actions=np.stack(actions, axis=1))
        return Steps.from_trajectories(played, goal, self._end_state)
