"""r(s, a | g): the one reward function that the learner trains with and the reward service serves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from giirl_core.config import Config
from giirl_core.nets.features import collate, collate_actions, collate_choices, featurise
from giirl_core.nets.language import Vectors, load_vectors
from giirl_core.nets.models import PolicyNet, RewardNet
from giirl_core.nets.parameters import load_net
from giirl_core.types import Action, Goal, Page, Trajectory, Weights

FORMS = ("logit", "d", "log_d", "gail", "goal")


def reward_of(logit: Tensor, form: str, clip: float) -> Tensor:
    """The reward for a discriminator logit, any shape, in nats (a probability for "d" and "goal").

    `logit`: log D - log(1 - D) (Algorithm 1 of Luo 2019); `d`: D (its section 3.1); `log_d`: log D; `gail`:
    -log(1 - D) (Ho and Ermon 2016); `goal`: 1 where D > 1/2 (AGILE; Bahdanau et al. 2019).
    After the last step nothing more is paid, so the end of an episode counts as a state of reward 0: the
    `logit` of a pair that expert and policy visit alike. `d` and `gail`, always positive, pay for stalling, and
    `log_d`, always negative, for ending early; they are for comparison.
    """
    logit = logit.clamp(-clip, clip)
    if form == "logit":
        return logit
    if form == "d":
        return torch.sigmoid(logit)
    if form == "log_d":
        return functional.logsigmoid(logit)
    if form == "gail":
        return functional.softplus(logit)
    if form == "goal":
        return (logit > 0).float()
    raise ValueError(f"there is no reward form {form!r}: wanted one of {', '.join(FORMS)}")


def episode_rewards(logits: Tensor, lengths: Sequence[int], form: str, clip: float) -> list[Tensor]:
    """The rewards [T] of whole episodes from the logits [sum T] of all their steps.

    `goal` asks whether an episode ended where it should, so it pays for the last step alone.
    """
    rewards = reward_of(logits, form, clip)
    parts = list(rewards.split(list(lengths)))
    if form == "goal":
        parts = [functional.pad(part[-1:], (len(part) - 1, 0)) for part in parts]
    return parts


class RewardModel:
    """A reward net with its form: trajectories in, rewards out."""

    def __init__(self, net: RewardNet, vectors: Vectors, form: str, clip: float) -> None:
        self.net, self.vectors, self.form, self.clip = net, vectors, form, clip

    def score_pairs(self, pages: Sequence[Page], actions: Sequence[Action], goals: Sequence[Goal]) -> Tensor:
        """[B] rewards of B (page, action, goal) triples."""
        return reward_of(self._logits(pages, actions, goals), self.form, self.clip)

    @torch.no_grad()
    def score_actions(self, page: Page, goal: Goal, actions: Sequence[Action]) -> NDArray[np.float32]:
        """[M] rewards of M actions on one page, which is read once."""
        self.net.eval()
        logits = self.net(collate([featurise(page, goal, self.vectors)]), collate_choices(actions))
        return reward_of(logits.squeeze(0), self.form, self.clip).numpy()

    def score(self, trajectories: Sequence[Trajectory]) -> list[NDArray[np.float32]]:
        """For each trajectory its [T] rewards."""
        pages = [page for trajectory in trajectories for page in trajectory.pages]
        actions = [action for trajectory in trajectories for action in trajectory.actions]
        goals = [trajectory.goal for trajectory in trajectories for _ in trajectory.pages]
        logits = self._logits(pages, actions, goals)
        lengths = [len(trajectory) for trajectory in trajectories]
        return [part.numpy() for part in episode_rewards(logits, lengths, self.form, self.clip)]

    @torch.no_grad()
    def _logits(self, pages: Sequence[Page], actions: Sequence[Action], goals: Sequence[Goal]) -> Tensor:
        rows = [featurise(page, goal, self.vectors) for page, goal in zip(pages, goals, strict=True)]
        self.net.eval()
        logits: Tensor = self.net(collate(rows), collate_actions(actions)).squeeze(1)
        return logits


def build_reward(config: Config, weights: Weights | None = None) -> RewardModel:
    """The reward of a run's config, with its weights when there are any."""
    vectors = load_vectors(config.net.vectors)
    net = RewardNet(vectors, config.net)
    if weights is not None:
        load_net(net, weights)
    return RewardModel(net, vectors, config.discriminator.reward, config.discriminator.clip)


def build_policy(config: Config) -> PolicyNet:
    """An untrained policy of a run's config."""
    return PolicyNet(load_vectors(config.net.vectors), config.net)
