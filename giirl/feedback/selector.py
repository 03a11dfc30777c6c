"""Plays pages with the policy of a run, and chooses the episodes that policy or reward are least sure of."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from threading import Event
from types import TracebackType

import numpy as np

from giirl.report.element_rewards import EpisodeView, ScoredPage
from giirl.report.inspector import Inspector
from giirl.report.numbers import weights_of
from giirl.run.folder import RunFolder
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.types import EpisodeSpec, Purpose, Trajectory, is_held_out, page_seed
from giirl_core.wire.answers import file_name

ROUND = 16  # episodes that are played before some of them are chosen
CHOSEN = 4  # of a round: the least sure ones, and the last one at random


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """An episode that a person may be asked about. The verdict in `view` is shown to nobody."""

    view: EpisodeView
    trajectory: Trajectory
    doubts: tuple[float, ...]  # [T] in [0, 1], see `doubt`

    @property
    def key(self) -> str:
        """The name of its page, and of the file with its answer."""
        return file_name(self.view.task, self.view.seed)


def doubt(scored: ScoredPage) -> float:
    """How unsure policy or reward is of the policy's action, in [0, 1]: the larger one of

    - 1 - pi(a | s, g), and
    - the probability that the maximum-entropy policy of the reward alone, softmax of r(s, . | g) over the best action
      on each element, acts otherwise.

    D near 1/2 is no doubt: an action that the policy takes as often as the expert has D = 1/2 because it is right.
    """
    by_policy = 1.0 - math.exp(scored.policy_logp)
    if not scored.best:
        return by_policy
    rewards = np.array([one.reward for one in scored.best])
    agrees = np.array([one.action == scored.policy_action for one in scored.best])
    odds = np.exp(rewards - rewards.max())
    return max(by_policy, 1.0 - float(odds[agrees].sum() / odds.sum()))


def candidate_of(view: EpisodeView) -> Candidate:
    """The candidate of an episode that was played to its end."""
    scored = [frame.own for frame in view.frames]
    trajectory = Trajectory(
        task=view.task,
        goal=scored[0].goal,
        seed=view.seed,
        pages=tuple(frame.page for frame in view.frames),
        actions=tuple(one.policy_action for one in scored if one.policy_action is not None),
        behaviour_logp=np.array([one.policy_logp for one in scored], dtype=np.float32),
        rewards=np.zeros(len(scored), dtype=np.float32),
        policy_version=0,
    )
    return Candidate(view=view, trajectory=trajectory, doubts=tuple(doubt(one) for one in scored))


class Selector:
    """Plays in a browser of its own, with the latest checkpoint of a run, which may be under way.

    ValueError for a run without a checkpoint.
    """

    def __init__(self, folder: RunFolder, config: Config, *, screenshots: bool = True, seed: int | None = None) -> None:
        self._folder, self._config = folder, config
        self._checkpoint = folder.latest_checkpoint()
        weights = weights_of(folder, config, self._checkpoint)
        self._inspector = Inspector(config, *weights, Metrics(), screenshots=screenshots)
        self._index = count()
        self._rng = np.random.default_rng(seed)

    def __enter__(self) -> Selector:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._inspector.__exit__(kind, error, trace)

    def choose(self, stop: Event) -> list[Candidate]:
        """Play ROUND pages without an answer, and return CHOSEN episodes, the least sure first; none after `stop`.

        One of them is drawn from the others at random: policy and reward can also be sure and wrong. Episodes that
        infrastructure broke, and those with a held-out instruction, are left out. RuntimeError if no page opens.
        """
        self._refresh()
        played, reasons = [], []
        for _ in range(ROUND):
            if stop.is_set():
                return []
            try:
                view = self._inspector.episode(self._next())
            except RuntimeError as error:
                reasons.append(str(error))
                continue
            if view.outcome is None:
                reasons.append(view.error)
            elif not is_held_out(view.frames[0].own.goal, self._config.held_out_goals):
                played.append(candidate_of(view))
        if len(reasons) == ROUND:
            raise RuntimeError(f"none of {ROUND} pages could be played: {reasons[-1]}")
        played.sort(key=lambda one: -max(one.doubts))
        sure = played[CHOSEN - 1 :]
        return played[: CHOSEN - 1] + ([sure[self._rng.integers(len(sure))]] if sure else [])

    def _next(self) -> EpisodeSpec:
        """The next page of the next task that has no answer yet."""
        tasks = self._config.tasks
        while True:
            index = next(self._index)
            task, seed = tasks[index % len(tasks)], page_seed(Purpose.FEEDBACK, self._config.seed, index // len(tasks))
            if not (self._folder.feedback / file_name(task, seed)).exists():
                return EpisodeSpec(task=task, seed=seed)

    def _refresh(self) -> None:
        """Use the latest checkpoint. A run under way may remove it meanwhile; then the next round tries again."""
        with suppress(OSError, ValueError):
            latest = self._folder.latest_checkpoint()
            if latest != self._checkpoint:
                self._inspector.load(*weights_of(self._folder, self._config, latest))
                self._checkpoint = latest
