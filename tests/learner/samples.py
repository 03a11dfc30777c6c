"""Small pages, goals, nets and demonstrations for the tests of the learner."""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from actors.agents import ExpertAgent, PolicyAgent
from actors.rollouts import play
from actors.schedule import Schedule
from browser_farm.experts import expert
from browser_farm.fake import TASKS, FakeFarm
from giirl_core.choices import Choice, SampledActions
from giirl_core.config import NetConfig
from giirl_core.metrics import Metrics
from giirl_core.nets.action_batch import ActionBatch, collate_candidates, collate_choices
from giirl_core.nets.batch import Batch, collate
from giirl_core.nets.features import Features, featurise
from giirl_core.nets.language import Vectors, load_vectors
from giirl_core.nets.layout import MATCH_KINDS
from giirl_core.nets.models import PolicyNet, RewardNet
from giirl_core.types import Action, Episode, EpisodeSpec, Goal, Observation, Page, Purpose, Trajectory, Verb

WIDTH = 16


def vectors() -> Vectors:
    """The small table of hashed word vectors."""
    return load_vectors("hashed")


def page(*rows: str, value: Sequence[str] = (), parent: Sequence[int] = ()) -> Page:
    """A page with one element per row; a row is "tag" or "tag:text"."""
    count = len(rows)
    tags, texts = zip(*(row.partition(":")[::2] for row in rows), strict=True) if rows else ((), ())
    return Page(
        tag=tags,
        text=texts,
        value=tuple(value) or ("",) * count,
        classes=("",) * count,
        ref=np.arange(count, dtype=np.int32) + 7,
        parent=np.array(parent or [-1] * count, dtype=np.int16),
        box=np.arange(count * 4, dtype=np.float32).reshape(count, 4),
        focused=np.zeros(count, dtype=np.bool_),
        tampered=np.zeros(count, dtype=np.bool_),
    )


LONG = page("div", "t:some words", "button:Ok", "input_text", "textarea", parent=(-1, 0, 0, 0, 0))
SHORT = page("button:ok", "input_text")
FLAT = page("button:Ok", "button:ok", "button:Cancel")
CASES = (
    (LONG, Goal('Enter "Ada Lovelace" into the text field and press "Ok".')),
    (SHORT, Goal("Type ok.")),
    (FLAT, Goal('Click on the "Ok" button.')),
)


def batch_of(*cases: tuple[Page, Goal]) -> Batch:
    """The batch of some pages under their goals."""
    return collate([featurise(case_page, goal, vectors()) for case_page, goal in cases])


def dense_matches(features: Features) -> NDArray[np.float32]:
    """[MATCH_KINDS, E, L] the weights of all matches as a dense table."""
    table = np.zeros((MATCH_KINDS, len(features.element_ids), len(features.token_ids)), dtype=np.float32)
    element, kind, token = features.match_ids.T
    table[kind, element, token] = features.match_weights
    return table


def on_one_page(actions: Sequence[Action]) -> ActionBatch:
    """[1, M] M actions on one page."""
    return collate_candidates([choice(action) for action in actions])


def choice(action: Action) -> Choice:
    """A click, or words that are typed, as a choice. The page is not looked at."""
    return Choice((Verb.CLICK, Verb.TYPE).index(action.verb), action.element, action.start, action.end)


def collate_actions(actions: Sequence[Action]) -> ActionBatch:
    """[B, 1] one action on each of B pages."""
    return collate_choices([choice(action) for action in actions])


def policy(seed: int = 0) -> PolicyNet:
    """An untrained policy net."""
    torch.manual_seed(seed)
    return PolicyNet(vectors(), NetConfig(width=WIDTH))


def reward_net(seed: int = 0) -> RewardNet:
    """An untrained reward net."""
    torch.manual_seed(seed)
    return RewardNet(vectors(), NetConfig(width=WIDTH))


def legal_actions(case_page: Page, goal: Goal) -> list[Action]:
    """All legal actions on a page under a goal: clicks first."""
    words = len(goal.tokens)
    clicks = [Action(verb=Verb.CLICK, element=e) for e in range(len(case_page)) if case_page.leaf[e]]
    return clicks + [
        Action(verb=Verb.TYPE, element=e, start=start, end=end)
        for e in range(len(case_page))
        if case_page.typable[e]
        for start in range(words)
        for end in range(start, words)
    ]


def trajectory(
    goal: str, pages: Sequence[Page], actions: Sequence[Action], *, task: str = "some-task", seed: int = 0
) -> Trajectory:
    """A demonstration with rewards 0."""
    return Trajectory(
        task=task,
        goal=Goal(goal),
        seed=seed,
        pages=tuple(pages),
        actions=tuple(actions),
        behaviour_logp=np.zeros(len(pages), dtype=np.float32),
        rewards=np.zeros(len(pages), dtype=np.float32),
        policy_version=-1,
    )


def expert_episodes(per_task: int, tasks: Sequence[str] = tuple(TASKS), tabs: int = 4) -> list[Episode]:
    """Episodes of the scripted experts in the fake browser."""
    browser = FakeFarm(tabs=tabs)
    schedule = Schedule(tasks, tabs, purpose=Purpose.DEMONSTRATE, run_seed=0, quota=per_task)
    rounds = play(browser, ExpertAgent(expert), schedule, step_limit=10, metrics=Metrics())
    return [episode for ended in rounds for episode in ended]


def with_sampled(shown: Trajectory, net: PolicyNet, count: int) -> Trajectory:
    """The same trajectory with `count` sampled actions at each step, as an actor with this policy samples them."""
    agent = PolicyAgent(deepcopy(net).cpu(), vectors(), sampled_actions=count)
    seen = [
        Observation(episode=EpisodeSpec(task=shown.task, seed=shown.seed), page=page, goal=shown.goal)
        for page in shown.pages
    ]
    uniform = np.random.default_rng(0).random((len(seen), agent.draws, 3), dtype=np.float32)
    decisions = agent.select_actions(seen, uniform)
    logp = np.stack([decision.sampled_logp for decision in decisions if decision.sampled_logp is not None])
    choices = np.stack([decision.sampled for decision in decisions if decision.sampled is not None])
    return replace(shown, sampled=SampledActions(choices=choices, logp=logp, rewards=np.zeros_like(logp)))
