"""Agents choose actions on pages: the policy net, scripted experts, or uniformly random actions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from browser_farm.experts import NoAction
from giirl_core.nets.action_batch import join, random_actions
from giirl_core.nets.batch import collate
from giirl_core.nets.features import featurise
from giirl_core.nets.language import Vectors
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.parameters import load_net
from giirl_core.types import DEMONSTRATION, Action, Observation, Verb
from giirl_core.weights import Weights


@dataclass(frozen=True, slots=True)
class Decision:
    """An action, its log-probability and the version of the policy that chose it."""

    action: Action
    logp: float  # nats
    version: int  # learner step of the policy
    sampled: NDArray[np.int16] | None = None  # [M, 4] further actions for the reward to score, as in SampledActions
    sampled_logp: NDArray[np.float32] | None = None  # [M] nats


class Agent(Protocol):
    """Chooses actions for a batch of observations."""

    @property
    def draws(self) -> int:
        """Triples of random numbers that it uses for each observation."""
        ...

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        """One decision for each of B observations.

        `uniform` [B, draws, 3] in [0, 1) holds the random numbers for each observation; an agent uses no others.
        """
        ...


class PolicyAgent:
    """The policy net. Samples actions, or takes the most likely one if `greedy`.

    On each page it also samples as many actions that are not taken as `sampled_actions` says, half of them its own and
    half uniform, whose rewards the learner can use as well.
    """

    def __init__(
        self, net: PolicyNet, vectors: Vectors, *, version: int = 0, greedy: bool = False, sampled_actions: int = 0
    ) -> None:
        self.net, self.vectors, self.version, self.greedy = net, vectors, version, greedy
        self.draws = 1 + sampled_actions

    def load(self, weights: Weights) -> None:
        """Replace the weights. Raises ValueError if they are older than the current ones, or corrupt."""
        if weights.version < self.version:
            raise ValueError(f"policy weights have version {weights.version}, wanted {self.version} or later")
        load_net(self.net, weights)
        self.version = weights.version

    @torch.no_grad()
    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        rows = [featurise(observation.page, observation.goal, self.vectors) for observation in observations]
        batch = collate(rows)
        encoding = self.net.encoder(batch)
        noise, own = torch.from_numpy(uniform), 1 + self.draws // 2
        actions, logp = self.net.sample(encoding, None if self.greedy else noise[:, :own])
        decisions = zip(actions.first(), logp[:, 0].tolist(), strict=True)
        if self.draws == 1:
            return [Decision(action, p, self.version) for action, p in decisions]
        random = random_actions(batch, noise[:, own:])
        table = join(actions.columns(1, own), random).table().numpy().astype(np.int16)
        table_logp = torch.cat([logp[:, 1:], self.net.evaluate(encoding, random)[0]], dim=1).numpy()
        return [Decision(action, p, self.version, table[b], table_logp[b]) for b, (action, p) in enumerate(decisions)]


class ExpertAgent:
    """A scripted expert for each task. If an expert finds no action, it waits until the step limit ends the episode."""

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


class RandomAgent:
    """Uniformly random: click any leaf or type into any field; the typed words are a random span of the goal."""

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
