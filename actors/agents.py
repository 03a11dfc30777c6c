"""Who decides what to do on a page: the policy net, a scripted expert, or chance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from numpy.typing import NDArray

from browser_farm.experts import NoAction
from giirl_core.nets.features import collate, featurise
from giirl_core.nets.language import Vectors
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.parameters import load_net
from giirl_core.types import DEMONSTRATION, Action, Observation, Verb, Weights


@dataclass(frozen=True, slots=True)
class Decision:
    """An action and how likely it was."""

    action: Action
    logp: float  # nats
    version: int  # of the policy that chose


class Agent(Protocol):
    """Chooses for B observations at once; `uniform` [B, 3] in [0, 1) is all the chance there is."""

    def __call__(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]: ...


class PolicyAgent:
    """The policy net; samples, or takes the likeliest action when `greedy`."""

    def __init__(self, net: PolicyNet, vectors: Vectors, *, version: int = 0, greedy: bool = False) -> None:
        self.net, self.vectors, self.version, self.greedy = net, vectors, version, greedy

    def load(self, weights: Weights) -> None:
        """Take over newer weights; older ones are refused."""
        if weights.version < self.version:
            raise ValueError(f"policy version {weights.version} is older than {self.version}, which is in use")
        load_net(self.net, weights)
        self.version = weights.version

    @torch.no_grad()
    def __call__(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        rows = [featurise(seen.page, seen.goal, self.vectors) for seen in observations]
        drawn = None if self.greedy else torch.from_numpy(uniform).unsqueeze(1)
        actions, logp = self.net.sample(collate(rows), drawn)
        return [
            Decision(action, p, self.version)
            for action, p in zip(actions.first(), logp.squeeze(1).tolist(), strict=True)
        ]


class ExpertAgent:
    """A scripted expert for every task; one that finds nothing to do waits, and its episode ends at the step limit."""

    def __init__(self, expert: Callable[[str], Callable[[Observation], Action]]) -> None:
        self._expert = expert

    def __call__(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        return [Decision(self._play(seen), 0.0, DEMONSTRATION) for seen in observations]

    def _play(self, seen: Observation) -> Action:
        try:
            return self._expert(seen.episode.task)(seen)
        except NoAction:
            return Action(verb=Verb.WAIT)


class RandomAgent:
    """Uniform over what may be done: clicking any leaf or typing into any field; and over the words to copy."""

    def __call__(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        return [self._one(seen, draws) for seen, draws in zip(observations, uniform, strict=True)]

    def _one(self, seen: Observation, uniform: NDArray[np.float32]) -> Decision:
        clicks, fields = np.flatnonzero(seen.page.leaf), np.flatnonzero(seen.page.typable)
        drawn = int(uniform[0] * (len(clicks) + len(fields)))
        logp = -np.log(len(clicks) + len(fields))
        if drawn < len(clicks):
            return Decision(Action(verb=Verb.CLICK, element=int(clicks[drawn])), logp, 0)
        words = len(seen.goal.tokens)
        start = int(uniform[1] * words)
        end = start + int(uniform[2] * (words - start))
        action = Action(verb=Verb.TYPE, element=int(fields[drawn - len(clicks)]), start=start, end=end)
        return Decision(action, logp - np.log(words) - np.log(words - start), 0)
