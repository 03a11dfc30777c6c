"""The algorithms by name, and the facts about each. `learner.algorithms` holds the training loop of each name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

WorldName = Literal["miniwob", "gridcraft"]


@dataclass(frozen=True, slots=True, kw_only=True)
class AlgorithmSpec:
    """What the rest of the system has to know about an algorithm."""

    title: str  # in the report
    reward: Literal["learned", "frozen", "environment", "none"]  # the reward that the policy maximises
    needs_demonstrations: bool  # False: none are collected, unless the policy also imitates (`policy`)
    worlds: tuple[WorldName, ...] = ("miniwob",)

    @property
    def uses_reward(self) -> bool:
        """True when the policy is trained on a reward, False when it imitates the demonstrations directly."""
        return self.reward != "none"

    @property
    def learns_reward(self) -> bool:
        """True when the run trains a discriminator."""
        return self.reward == "learned"

    @property
    def has_learned_reward(self) -> bool:
        """True when the run ends with a learned reward: its own, or the one that it took over."""
        return self.reward in ("learned", "frozen")


ALGORITHMS: dict[str, AlgorithmSpec] = {
    "giirl": AlgorithmSpec(title="GIIRL", reward="learned", needs_demonstrations=True, worlds=("miniwob", "gridcraft")),
    "cloning": AlgorithmSpec(
        title="Cloning", reward="none", needs_demonstrations=True, worlds=("miniwob", "gridcraft")
    ),
    "frozen": AlgorithmSpec(title="Frozen reward", reward="frozen", needs_demonstrations=False),
    "true_reward": AlgorithmSpec(title="True reward", reward="environment", needs_demonstrations=False),
    "sqil": AlgorithmSpec(title="SQIL", reward="none", needs_demonstrations=True),
    "q_learning": AlgorithmSpec(title="Q-learning", reward="environment", needs_demonstrations=False),
    "wge": AlgorithmSpec(title="WGE", reward="environment", needs_demonstrations=True),
    "iq_learn": AlgorithmSpec(title="IQ-Learn", reward="none", needs_demonstrations=True),
}


def algorithm_names(world: WorldName | None = None) -> str:
    """The algorithms that play `world`, or all of them, for an error message: "'giirl' or 'cloning'"."""
    return " or ".join(repr(name) for name, spec in ALGORITHMS.items() if world is None or world in spec.worlds)
