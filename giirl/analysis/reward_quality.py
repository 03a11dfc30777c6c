"""How good a learned reward is: as a judge of episodes, as a judge of steps, and in use.

All numbers come from episodes that a policy plays on pages that training never saw. The verdict of the page is what the
judgements are compared with.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from rich.table import Column, Table

from actors.browser import measured_tasks
from actors.player import AgentSpec, open_browser_player
from giirl.analysis.goal_sensitivity import goal_steps, measure
from giirl.statistics import percent
from giirl_core.config import Config
from giirl_core.metrics import Metrics
from giirl_core.nets.action_batch import collate_choices, join, random_actions
from giirl_core.nets.batch import collate
from giirl_core.nets.features import featurise
from giirl_core.nets.reward import RewardModel, build_reward, reward_of
from giirl_core.progress import Display
from giirl_core.types import Episode, Purpose, Trajectory
from giirl_core.weights import Weights

BATCH = 64  # episodes that are scored at a time
NEGATIVES = 4  # other legal actions that a step's action is compared with
DRAWS = 12  # random actions that they are taken from: some are the action itself
# Chosen on tuning seeds 100 and 101 of the 52 tasks, for the reward form `logit`.
UNDONE = 0.6  # what is left of a negative reward after each further step, since a mistake may be undone
SURE_RIGHT, SURE_WRONG = 0.7, -2.0  # nats: verdicts above and below these are sure
USES = ("sampled", "best_attempt", "likeliest", "oracle")  # ways to choose one of several attempts
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt:
    """One episode of the policy, as the page judged it and as the reward does."""

    task: str
    seed: int
    won: bool
    verdict: float  # above 0 if the reward calls it right: see `verdict`
    logp: float  # log-probability of its actions under the policy, nats


def reward_quality(
    config: Config, reward: Weights, policy: Weights, pages: int, attempts: int, metrics: Metrics, display: Display
) -> dict[str, Any]:
    """Play `pages` pages of each task greedily, and `attempts` times by sampling, and judge all of it.

    - Episodes: the reward calls an episode right if every step has D > 1/2 (`verdict`). Precision, recall, F1 and the
      negative predictive value (`npv`) against the page's verdict; `auc` needs no threshold. `sure_precision` and
      `sure_npv` are of the episodes with a verdict above SURE_RIGHT or below SURE_WRONG, the fraction `sure` of all.
    - Steps of successful greedy episodes, against NEGATIVES random other legal actions on the same page: how often the
      action taken has the highest reward (`best_of_n`), how often it beats one of them (`pairwise`), and its mean
      reciprocal rank (`mrr`). Ties count against the reward. `swapped_goal` is the fraction of steps that depend on the
      goal with a higher reward under their own goal than under that of another page.
    - In use: success of the attempt with the highest verdict (`best_attempt`), beside that of the `greedy`
      policy, of one attempt (`sampled`), of the attempt that the policy itself finds most likely (`likeliest`), and of
      the best attempt by the page's verdict (`oracle`).
    """
    model, tasks = build_reward(config, reward), measured_tasks(config)
    greedy = AgentSpec(kind="greedy", policy=policy)
    specs = [AgentSpec(kind="sampling", policy=policy, attempt=k) for k in range(attempts)]
    with (
        open_browser_player(config, metrics) as player,
        display.job("playing", pages * len(tasks) * (1 + attempts)) as job,
    ):
        played = player.play(greedy, Purpose.INSPECT, pages, tasks=tasks, job=job)
        tried = [player.play(spec, Purpose.INSPECT, pages, tasks=tasks, job=job) for spec in specs]
    judged = [attempt for episodes in tried for attempt in _judge(model, episodes)]
    rows = {task: _row(config, model, task, played, judged) for task in tasks}
    everything = {**outcome_measures(judged), **_mean([row for row in rows.values() if row["pages"]])}
    return {"all": everything, "tasks": rows, "settings": {"pages": pages, "attempts": attempts}}


def outcome_measures(judged: Sequence[Attempt]) -> dict[str, Any]:
    """How the reward's verdicts on episodes agree with the page's. None where there is nothing to divide by."""
    won = np.array([one.won for one in judged], dtype=bool)
    verdicts = np.array([one.verdict for one in judged])
    called, right, wrong = verdicts > 0, verdicts > SURE_RIGHT, verdicts < SURE_WRONG
    both = int((won & called).sum())
    precision, recall = _share(both, int(called.sum())), _share(both, int(won.sum()))
    return {
        "episodes": len(judged),
        "precision": precision,
        "recall": recall,
        "f1": None if precision is None or recall is None else _share(2 * both, int(called.sum() + won.sum())),
        "npv": _share(int((~won & ~called).sum()), int((~called).sum())),
        "auc": _auc(verdicts[won], verdicts[~won]),
        "sure": _share(int((right | wrong).sum()), len(judged)),
        "sure_precision": _share(int((won & right).sum()), int(right.sum())),
        "sure_npv": _share(int((~won & wrong).sum()), int(wrong.sum())),
    }


def uses(judged: Sequence[Attempt]) -> dict[str, float]:
    """Success of one attempt at a page, of the one that the reward prefers, of the likeliest, and of the best one."""
    by_page: dict[tuple[str, int], list[Attempt]] = defaultdict(list)
    for one in judged:
        by_page[one.task, one.seed].append(one)
    pages = by_page.values()
    return {
        "sampled": fmean(one.won for one in judged),
        "best_attempt": fmean(max(tried, key=lambda one: one.verdict).won for tried in pages),
        "likeliest": fmean(max(tried, key=lambda one: one.logp).won for tried in pages),
        "oracle": fmean(any(one.won for one in tried) for tried in pages),
    }


def quality_table(found: dict[str, Any]) -> Table:
    """A row for each task, and one for all."""
    verdicts = ("precision", "recall", "f1", "npv", "sure", "sure_precision", "sure_npv")
    names = (*verdicts, "best_of_n", "pairwise", "mrr", "swapped_goal", "greedy", *USES)
    table = Table("task", *(Column(name.replace("_", " "), justify="right") for name in names), title="reward, %")
    for task, row in [*found["tasks"].items(), ("all", found["all"])]:
        table.add_row(task, *(percent(row[name]) for name in names))
    return table


def _row(
    config: Config, model: RewardModel, task: str, played: Sequence[Episode], judged: Sequence[Attempt]
) -> dict[str, Any]:
    own = [one for one in judged if one.task == task]
    greedy = [episode for episode in played if episode.trajectory.task == task]
    won = [episode.trajectory for episode in greedy if episode.outcome.success]
    steps = [step for trajectory in won for step in goal_steps(trajectory)]
    swapped = measure(model, steps, config.seed)["auc"] if len({step.goal for step in steps}) > 1 else None
    return {
        "pages": len(greedy),
        **outcome_measures(own),
        **_measure_steps(model, won, config.seed),
        "swapped_goal": swapped,
        "greedy": fmean(episode.outcome.success for episode in greedy) if greedy else None,
        **(uses(own) if own else dict.fromkeys(USES)),
    }


def _mean(rows: Sequence[dict[str, Any]]) -> dict[str, float | None]:
    """Means over tasks of all but the outcome measures, which all episodes share."""
    names = ("best_of_n", "pairwise", "mrr", "swapped_goal", "greedy", *USES)
    columns = {name: [row[name] for row in rows if row[name] is not None] for name in names}
    return {name: fmean(column) if column else None for name, column in columns.items()}


def verdict(rewards: NDArray[np.floating[Any]]) -> float:
    """The lowest of the rewards [T] of an episode, less that of D = 1/2 each, where early mistakes count less.

    A negative reward is multiplied by UNDONE for each step that follows it.
    """
    weights = np.where(rewards < 0, UNDONE ** np.arange(len(rewards) - 1, -1, -1), 1.0)
    return float((rewards * weights).min())


def _judge(model: RewardModel, episodes: Sequence[Episode]) -> list[Attempt]:
    even = float(reward_of(torch.zeros(1), model.form, model.clip))
    judged: list[Attempt] = []
    for first in range(0, len(episodes), BATCH):
        part = episodes[first : first + BATCH]
        rewards = model.score([episode.trajectory for episode in part])
        judged += [
            Attempt(
                task=e.trajectory.task,
                seed=e.trajectory.seed,
                won=e.outcome.success,
                verdict=verdict(steps - even),
                logp=float(e.trajectory.behaviour_logp.sum()),
            )
            for e, steps in zip(part, rewards, strict=True)
        ]
    return judged


def _measure_steps(model: RewardModel, won: Sequence[Trajectory], seed: int) -> dict[str, Any]:
    """The action of every step against random others; steps on pages with too few other actions are left out."""
    return step_measures(
        [rank for i in range(0, len(won), BATCH) for rank in _rank_steps(model, won[i : i + BATCH], seed + i)]
    )


def step_measures(ranks: Sequence[int]) -> dict[str, Any]:
    """The measures of steps, from the rank of each; None without steps."""
    return {
        "steps": len(ranks),
        "best_of_n": fmean(rank == 1 for rank in ranks) if ranks else None,
        "pairwise": fmean((1 + NEGATIVES - rank) / NEGATIVES for rank in ranks) if ranks else None,
        "mrr": fmean(1 / rank for rank in ranks) if ranks else None,
    }


@torch.no_grad()
def _rank_steps(model: RewardModel, won: Sequence[Trajectory], seed: int) -> list[int]:
    """The rank, from 1, of each step's action among itself and NEGATIVES others."""
    batch = collate([featurise(page, one.goal, model.vectors) for one in won for page in one.pages])
    gestures = model.net.gestures
    taken = collate_choices([choice for one in won for choice in one.choices(gestures)])
    uniform = torch.rand(len(batch), DRAWS, 3, generator=torch.Generator().manual_seed(seed))
    drawn = random_actions(batch, uniform, gestures)
    model.net.eval()
    logits = model.net(batch.to(model.device), join(taken, drawn).to(model.device)).cpu().numpy()
    other = (drawn.table() != taken.table()).any(2).numpy()
    return ranks(logits, other)


def ranks(logits: NDArray[np.float32], other: NDArray[np.bool_]) -> list[int]:
    """The rank, from 1, of each step's action among itself and its first NEGATIVES others; ties count against it.

    `logits` [T, 1 + DRAWS] are those of the action and of random ones, and `other` [T, DRAWS] says which of these are
    not the action itself. Steps with fewer others are left out.
    """
    drawn = [row[differs][:NEGATIVES] for row, differs in zip(logits[:, 1:], other, strict=True)]
    return [
        1 + int((negatives >= own).sum())
        for own, negatives in zip(logits[:, 0], drawn, strict=True)
        if len(negatives) == NEGATIVES
    ]


def _share(part: int, whole: int) -> float | None:
    return round(part / whole, 4) if whole else None


def _auc(above: Array, below: Array) -> float | None:
    """The probability that a member of the first group exceeds one of the second; ties count half."""
    if not len(above) or not len(below):
        return None
    pairs = above[:, None] - below[None]
    return round(float((pairs > 0).mean() + 0.5 * (pairs == 0).mean()), 4)
