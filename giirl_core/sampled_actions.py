"""Actions that were sampled on the pages of a trajectory but not taken. A learned reward can score them as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.actions import NO_SPAN, Verb


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledActions:
    """M actions per step of a trajectory that were sampled but not taken, with their rewards.

    Half of them are sampled from the policy, half uniformly from the legal actions. ValueError if the shapes differ.
    """

    choices: NDArray[np.int16]  # [T, M, 4] verb, element, first and last goal token to type (-1 for a click)
    logp: NDArray[np.float32]  # [T, M] nats, log mu(a | s_t, g) under the acting policy, also of the uniform half
    rewards: NDArray[np.float32]  # [T, M] r(s_t, a | g) of the trajectory's reward_version; 0 while unscored

    def __post_init__(self) -> None:
        steps = self.choices.shape[:2]
        if self.choices.shape != (*steps, 4) or self.logp.shape != steps or self.rewards.shape != steps:
            raise ValueError(
                f"SampledActions.choices has shape {self.choices.shape}, .logp {self.logp.shape} and .rewards "
                f"{self.rewards.shape}, wanted [T, M, 4], [T, M] and [T, M]"
            )

    def check(self, elements: Sequence[int], words: int) -> None:
        """ValueError unless every action is legal.

        `elements` [T] is the number of elements on each page, `words` the number of tokens of the goal.
        """
        if len(self.choices) != len(elements):
            raise ValueError(f"Trajectory.sampled has {len(self.choices)} steps, .pages has {len(elements)}")
        verb, element, start, end = np.moveaxis(self.choices, 2, 0)
        types = (verb == Verb.TYPE) & (start >= 0) & (start <= end) & (end < words)
        clicks = (verb == Verb.CLICK) & (start == NO_SPAN) & (end == NO_SPAN)
        legal = (element >= 0) & (element < np.array(elements)[:, None]) & (types | clicks)
        if not legal.all():
            t, m = (int(index) for index in np.argwhere(~legal)[0])
            raise ValueError(
                f"sampled action {m} of step {t} is {self.choices[t, m].tolist()}, wanted a click or words to type "
                f"on a page with {elements[t]} elements under a goal with {words} words"
            )
