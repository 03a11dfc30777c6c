"""Actions that were drawn on the pages of a trajectory but not taken: a learned reward can score them all the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from giirl_core.actions import NO_SPAN, Verb


@dataclass(frozen=True, slots=True, kw_only=True)
class SampledActions:
    """M further actions on each page of a trajectory: drawn but not taken, for the reward to score.

    Half of them are drawn from the policy, half uniformly from the legal actions.
    """

    choices: NDArray[np.int16]  # [T, M, 4] verb, element, first and last word (-1 where nothing is typed)
    logp: NDArray[np.float32]  # [T, M] nats, log mu(a | s_t, g) of the policy that drew, of the uniform half too
    rewards: NDArray[np.float32]  # [T, M] r(s_t, a | g) of the trajectory's reward_version; zeros while unscored

    def __post_init__(self) -> None:
        steps = self.choices.shape[:2]
        if self.choices.shape != (*steps, 4) or self.logp.shape != steps or self.rewards.shape != steps:
            raise ValueError(
                f"SampledActions.choices has shape {self.choices.shape}, .logp {self.logp.shape} and .rewards "
                f"{self.rewards.shape}, wanted [T, M, 4], [T, M] and [T, M]"
            )

    def check(self, elements: Sequence[int], words: int) -> None:
        """ValueError unless every action is legal on pages with so many elements under a goal of so many words."""
        if len(self.choices) != len(elements):
            raise ValueError(f"Trajectory.sampled has {len(self.choices)} steps, .pages has {len(elements)}")
        verb, element, start, end = np.moveaxis(self.choices, 2, 0)
        types = (verb == Verb.TYPE) & (start >= 0) & (start <= end) & (end < words)
        clicks = (verb == Verb.CLICK) & (start == NO_SPAN) & (end == NO_SPAN)
        legal = (element >= 0) & (element < np.array(elements)[:, None]) & (types | clicks)
        if not legal.all():
            t, m = (int(place) for place in np.argwhere(~legal)[0])
            raise ValueError(
                f"sampled action {m} of step {t} is {self.choices[t, m].tolist()}, wanted a click or words to type "
                f"on a page with {elements[t]} elements under a goal with {words} words"
            )
