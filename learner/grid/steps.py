"""What is learned from in LanguageGridCraft: steps by number, played by an expert, by the policy or by chance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import safetensors.numpy
import torch
from numpy.typing import NDArray

from gridcraft.instructions import Pair
from gridcraft.planning import Paths, draw_paths, random_policy, solve
from gridcraft.world import HORIZON, World, draw_starts, step, true_reward
from learner.grid.nets import STAY, GridFeatures, QNet

Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """N steps, each under a sentence; the index of state, action and sentence is all there is to one."""

    state: Index  # [N]
    action: Index  # [N]
    following: Index  # [N] the state it led to
    goal: Index  # [N] which sentence

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

    def draw(self, count: int, rng: np.random.Generator) -> Steps:
        """So many of them, with repetition; none when there are none."""
        return self.pick(rng.integers(len(self), size=count if len(self) else 0))

    def under(self, goal: Index) -> Steps:
        """The same steps under other sentences."""
        return Steps(state=self.state, action=self.action, following=self.following, goal=goal)

    @classmethod
    def join(cls, parts: Sequence[Steps]) -> Steps:
        """One after the other."""
        return cls(
            state=np.concatenate([part.state for part in parts]),
            action=np.concatenate([part.action for part in parts]),
            following=np.concatenate([part.following for part in parts]),
            goal=np.concatenate([part.goal for part in parts]),
        )

    @classmethod
    def of(cls, paths: Paths, goal: Index, end: int | None) -> Steps:
        """The steps of episodes [N, T] under sentences [N]; with `end` each leads there at last, and stays."""
        states, actions = paths.states, paths.actions
        if end is not None:
            ends = np.full((len(states), 1), end)
            states = np.concatenate([states[:, :-1], ends, ends], axis=1)
            actions = np.concatenate([actions, np.full_like(ends, STAY)], axis=1)
        return cls(
            state=states[:, :-1].ravel(),
            action=actions.ravel(),
            following=states[:, 1:].ravel(),
            goal=np.repeat(goal, actions.shape[1]),
        )

    def seal(self) -> bytes:
        """As safetensors."""
        blob: bytes = safetensors.numpy.save({name: getattr(self, name) for name in COLUMNS})
        return blob

    @classmethod
    def unseal(cls, blob: bytes) -> Steps:
        """The inverse."""
        return cls(**safetensors.numpy.load(blob))


EXPERT_TEMPERATURE = 0.1  # of the soft-optimal expert that demonstrates
COLUMNS = tuple(field.name for field in fields(Steps))
NOTHING = Steps(**{name: np.zeros(0, dtype=np.int64) for name in COLUMNS})


def expert_steps(
    world: World,
    pairs: Sequence[Pair],
    sentences: Sequence[Sequence[int]],
    count: int,
    temperature: float,
    rng: np.random.Generator,
    end: int | None,
) -> Steps:
    """`count` demonstrations of each pair in each layout by soft value iteration on the true reward.

    `sentences[i]` are the numbers of those that say pairs[i]; each demonstration is under one of them.
    """
    parts = []
    for pair, said in zip(pairs, sentences, strict=True):
        pi = solve(world, true_reward(world, pair), temperature=temperature).pi
        for number in range(len(world.layouts)):
            start = np.where(world.layout == number, world.start, 0.0)
            starts = rng.choice(len(world), size=count, p=start / start.sum())
            goal = rng.choice(np.array(said), size=count)
            parts.append(Steps.of(draw_paths(world, pi, starts, rng), goal, end))
    return Steps.join(parts)


def random_steps(world: World, goals: Sequence[int], count: int, rng: np.random.Generator, end: int | None) -> Steps:
    """`count` episodes of a policy that does anything, under any of the sentences."""
    paths = draw_paths(world, random_policy(world), draw_starts(world, count, rng), rng)
    return Steps.of(paths, rng.choice(np.array(goals), size=count), end)


class GridDemos:
    """D_E: the experts' episodes, and the same steps under sentences that mean something else."""

    def __init__(self, steps: Steps, length: int, meaning: Index, goals: Index, rng: np.random.Generator) -> None:
        self.steps, self._length, self._rng = steps, length, rng
        self._others = {m: goals[meaning[goals] != m] for m in set(meaning[goals].tolist())}
        self._meaning = meaning
        self._stood = np.zeros((meaning.max() + 1, max(steps.state.max(), steps.following.max()) + 1), dtype=np.bool_)
        self._stood[meaning[steps.goal], steps.state] = True  # [meaning, S] where experts were seen

    def sample(self, count: int) -> Steps:
        """So many episodes, with repetition."""
        episodes = self._rng.integers(len(self.steps) // self._length, size=count)
        return self.steps.pick((episodes[:, None] * self._length + np.arange(self._length)).ravel())

    def wrong_goals(self, expert: Steps) -> Steps:
        """Each step under a sentence of another meaning, drawn anew; but none where experts of that sentence were seen.

        Being there is not wrong. What is left says where to go and, of two sentences with one goal, what to avoid.
        """
        if len(self._others) < 2:
            return NOTHING
        goal = np.zeros_like(expert.goal)
        for meaning, others in self._others.items():
            own = self._meaning[expert.goal] == meaning
            goal[own] = self._rng.choice(others, size=int(own.sum()))
        return expert.under(goal).pick(np.flatnonzero(~self._stood[self._meaning[goal], expert.state]))


class GridSource:
    """Plays the policy under random sentences of those that training may see."""

    def __init__(self, world: World, sight: GridFeatures, goals: Index, net: QNet, rng: np.random.Generator) -> None:
        self.world, self._sight, self._goals, self._net, self._rng = world, sight, goals, net, rng
        self._end = sight.end if sight.absorbing else None
        self.env_steps = 0

    @torch.no_grad()
    def take(self, episodes: int) -> Steps:
        """So many episodes of HORIZON steps."""
        goal = self._rng.choice(self._goals, size=episodes)
        states, actions = [draw_starts(self.world, episodes, self._rng)], []
        for _ in range(HORIZON):
            pi = self._net.log_policy(self._sight.wide(states[-1], goal)).exp().numpy()
            below = np.cumsum(pi, axis=1)[:, :-1] <= self._rng.random((episodes, 1))
            actions.append(below.sum(axis=1))
            states.append(step(self.world, states[-1], actions[-1], self._rng))
        self.env_steps += episodes * HORIZON
        paths = Paths(states=np.stack(states, axis=1), actions=np.stack(actions, axis=1))
        return Steps.of(paths, goal, self._end)
