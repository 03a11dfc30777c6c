"""Agents that choose actions on pages: the policy net, scripted experts, blind replay, and the random policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from browser_farm.experts import NoAction
from giirl_core.choices import action_of
from giirl_core.nets.action_batch import choose, collate_candidates, join, random_actions
from giirl_core.nets.batch import collate
from giirl_core.nets.features import featurise
from giirl_core.nets.language import Vectors
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.parameters import load_net
from giirl_core.types import (
    DEMONSTRATION,
    NO_ELEMENT,
    NO_SPAN,
    Action,
    Goal,
    Observation,
    Page,
    Trajectory,
    Verb,
)
from giirl_core.weights import Weights


@dataclass(frozen=True, slots=True)
class Decision:
    """The action that an agent takes on one page, and the M sampled actions that it does not take."""

    action: Action
    logp: float  # nats, log-probability of the action
    version: int  # of the policy: the learner step that produced it
    sampled: NDArray[np.int16] | None = None  # [M, 4] as SampledActions.choices; None without sampled actions
    sampled_logp: NDArray[np.float32] | None = None  # [M] nats


class Agent(Protocol):
    """Chooses actions for a batch of observations."""

    @property
    def draws(self) -> int:
        """Triples of random numbers that the agent uses for one observation."""
        ...

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        """One decision for each of B observations.

        `uniform` [B, draws, 3] in [0, 1) holds all random numbers that the agent may use.
        """
        ...


class PolicyAgent:
    """The policy net. It samples its action, or takes the most probable one if `greedy`.

    On each page it also samples `sampled_actions` actions that are not taken, half from the policy and half uniformly.
    The reward scores them too, and the learner trains on these scores.
    """

    def __init__(
        self, net: PolicyNet, vectors: Vectors, *, version: int = 0, greedy: bool = False, sampled_actions: int = 0
    ) -> None:
        self.net, self.vectors, self.version, self.greedy = net, vectors, version, greedy
        self.draws = 1 + sampled_actions

    def load(self, weights: Weights) -> None:
        """Replace the parameters. ValueError if `weights` are older than they are, corrupt or of another net."""
        if weights.version < self.version:
            raise ValueError(f"policy weights have version {weights.version}, wanted {self.version} or later")
        load_net(self.net, weights)
        self.version = weights.version

    @torch.no_grad()
    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        rows = [featurise(observation.page, observation.goal, self.vectors) for observation in observations]
        batch = collate(rows)
        encoding = self.net.encoder(batch)
        noise, by_policy = torch.from_numpy(uniform), 1 + self.draws // 2
        actions, logp = self.net.sample(encoding, None if self.greedy else noise[:, :by_policy])
        chosen = [
            action_of(choice, observation.page, self.net.gestures)
            for choice, observation in zip(actions.first(), observations, strict=True)
        ]
        decisions = zip(chosen, logp[:, 0].tolist(), strict=True)
        if self.draws == 1:
            return [Decision(action, p, self.version) for action, p in decisions]
        random = random_actions(batch, noise[:, by_policy:], self.net.gestures)
        table = join(actions.columns(1, by_policy), random).table().numpy().astype(np.int16)
        table_logp = torch.cat([logp[:, 1:], self.net.evaluate(encoding, random)[0]], dim=1).numpy()
        return [Decision(action, p, self.version, table[b], table_logp[b]) for b, (action, p) in enumerate(decisions)]

    @torch.no_grad()
    def log_probabilities(self, observation: Observation, actions: Sequence[Action]) -> NDArray[np.float32]:
        """[M] log pi(a | s, g) of M actions on one page, nats; ValueError for one that is no gesture of the net."""
        encoding = self.net.encoder(collate([featurise(observation.page, observation.goal, self.vectors)]))
        candidates = collate_candidates([choose(action, observation.page, self.net.gestures) for action in actions])
        logp: NDArray[np.float32] = self.net.evaluate(encoding, candidates)[0][0].numpy()
        return logp


class FurtherAttempt:
    """An agent that has made so many attempts at a page before. It uses other random numbers in each."""

    def __init__(self, agent: Agent, attempts_before: int) -> None:
        self._agent, self._first = agent, attempts_before * agent.draws

    @property
    def draws(self) -> int:
        return self._first + self._agent.draws

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        return self._agent.select_actions(observations, uniform[:, self._first :])


class ExpertAgent:
    """The scripted expert of each task. If it has no action for a page, it waits until the step limit."""

    draws = 1

    def __init__(self, expert: Callable[[str], Callable[[Observation], Action]]) -> None:
        self._expert_for = expert

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        return [Decision(self._act(observation), 0.0, DEMONSTRATION) for observation in observations]

    def _act(self, observation: Observation) -> Action:
        try:
            return self._expert_for(observation.episode.task)(observation)
        except NoAction:
            return Action(verb=Verb.WAIT)


class ReplayAgent:
    """Blind replay: repeats the demonstration of the same task whose instruction is nearest, then waits.

    Nearest is the one that shares the largest part of its words (Jaccard). Each action goes to the element that is most
    like that of the demonstration. Typed text is that of the demonstration, whatever the new instruction says.
    """

    draws = 1

    def __init__(self, demonstrations: Sequence[Trajectory]) -> None:
        self._demonstrations = demonstrations

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        return [Decision(_repeat(self._nearest(one), one), 0.0, DEMONSTRATION) for one in observations]

    def _nearest(self, observation: Observation) -> Trajectory:
        """ValueError for a task without demonstrations."""
        task, words = observation.episode.task, _words(observation.goal)
        own = [one for one in self._demonstrations if one.task == task]
        if not own:
            raise ValueError(f"there is no demonstration of {task!r} to replay")
        return max(own, key=lambda one: len(words & _words(one.goal)) / len(words | _words(one.goal)))


def _repeat(shown: Trajectory, observation: Observation) -> Action:
    """The action of a demonstration at this step of an episode, on its page; after the last one, to wait."""
    page, t = observation.page, observation.step
    if t >= len(shown):
        return Action(verb=Verb.WAIT)
    action = shown.actions[t]
    element, to = (_most_alike(page, shown.pages[t], row) for row in (action.element, action.to))
    return replace(action, element=element, to=to, start=NO_SPAN, end=NO_SPAN, literal=action.text(shown.goal))


def _words(goal: Goal) -> set[str]:
    return {token.lower() for token in goal.tokens}


def _most_alike(page: Page, then: Page, row: int) -> int:
    """The element of `page` that is most like that in `row` of an earlier page: text, kind, attributes, place."""
    if row == NO_ELEMENT:
        return NO_ELEMENT

    def likeness(other: int) -> tuple[int, int]:
        same = sum(
            weight * (getattr(page, name)[other] == getattr(then, name)[row])
            for name, weight in (("text", 4), ("attributes", 2), ("tag", 2), ("classes", 1))
        )
        return same, -abs(other - row)

    return max(range(len(page)), key=likeness)


class RandomAgent:
    """The random policy: clicks a random leaf, or types a random span of the goal into a random field."""

    draws = 1

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        return [self._decide(observation, row[0]) for observation, row in zip(observations, uniform, strict=True)]

    def _decide(self, observation: Observation, uniform: NDArray[np.float32]) -> Decision:
        leaves, fields = np.flatnonzero(observation.page.leaf), np.flatnonzero(observation.page.typable)
        index = int(uniform[0] * (len(leaves) + len(fields)))
        logp = -np.log(len(leaves) + len(fields))
        if index < len(leaves):
            return Decision(Action(verb=Verb.CLICK, element=int(leaves[index])), logp, 0)
        words = len(observation.goal.tokens)
        start = int(uniform[1] * words)
        end = start + int(uniform[2] * (words - start))
        action = Action(verb=Verb.TYPE, element=int(fields[index - len(leaves)]), start=start, end=end)
        return Decision(action, logp - np.log(words) - np.log(words - start), 0)
