"""What GIIRL is compared with: each learns by its own rule, on the same nets, from nothing else than it may."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from giirl.config import Config, DiscriminatorConfig, SoftQConfig
from giirl.goals import is_held_out
from giirl.metrics import Metrics
from giirl.reward import episode_rewards
from giirl.spec import Action, Goal, Verb
from learner.algorithms import ALGORITHMS
from learner.discriminator import Discriminator
from learner.examples import Replay, collate_steps, last_step, steps_of, study
from learner.losses import iq_loss, sqil_loss, trimmed
from learner.soft_q import SoftQ
from tests.learning.samples import FLAT, SHORT, legal_actions, policy, trajectory, vectors

GOAL = "Type ok."
RIGHT = Action(verb=Verb.TYPE, element=1, start=1, end=1)


def test_sqil_pays_one_for_the_expert_and_nothing_for_the_policy() -> None:
    expert, rollouts = torch.tensor([0.5, 2.0]), torch.tensor([0.25, -1.0, 0.0])
    naive = (0.25 + 1.0) / 2 + (0.0625 + 1.0 + 0.0) / 3
    assert sqil_loss(expert, rollouts).item() == pytest.approx(naive)
    assert sqil_loss(torch.ones(3), torch.zeros(5)).item() == 0.0


def test_iq_learn_has_its_optimum_where_the_expert_goes_and_nobody_else() -> None:
    expert, rollouts = torch.tensor([0.3, -0.2]), torch.tensor([0.1])
    drop = torch.tensor([0.5, 0.7, 0.9])
    naive = (0.5 + 0.7 + 0.9) / 3 - (0.3 - 0.2) / 2 + (0.09 + 0.04 + 0.01) / 3 / (4 * 0.5)
    assert iq_loss(expert, rollouts, drop, 0.5).item() == pytest.approx(naive)


def test_trimming_takes_the_highest_share_away() -> None:
    logits = torch.tensor([3.0, -1.0, 2.0, 0.0])
    assert sorted(trimmed(logits, 0.25).tolist()) == [-1.0, 0.0, 2.0]
    assert torch.equal(trimmed(logits, 0.0), logits)
    assert torch.equal(trimmed(logits, 0.2), logits)  # less than one of four


def test_a_goal_reward_pays_for_how_an_episode_ends_and_for_nothing_before() -> None:
    logits = torch.tensor([4.0, -1.0, 2.0, 3.0, -2.0])
    parts = episode_rewards(logits, [3, 2], "goal", 5.0)
    assert [part.tolist() for part in parts] == [[0.0, 0.0, 1.0], [0.0, 0.0]]
    assert [len(part) for part in episode_rewards(logits, [3, 2], "logit", 5.0)] == [3, 2]


def test_a_discriminator_of_ends_is_shown_last_steps_only(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Any] = []

    def remember(example: Any, draw: Any) -> Any:
        shown.append(example)
        return last_step(example, draw)

    monkeypatch.setattr("learner.discriminator.last_step", remember)
    config = replace(DiscriminatorConfig(), judges="ends", batch=4, rollouts=1.0, replay=1.0)
    draw = np.random.default_rng(0)
    demos: Any = SimpleNamespace(wrong_goals=lambda expert: [])
    model: Any = SimpleNamespace(net=torch.nn.Linear(1, 1))
    judge = Discriminator(
        config, model, demos, Replay(4, draw), draw, torch.Generator(), reward_lag=1, metrics=Metrics()
    )
    long = study(trajectory(GOAL, [SHORT, FLAT], [RIGHT, Action(verb=Verb.CLICK, element=0)]), vectors())
    judge.replay.add([long])
    sources = judge._sources([long], [long], policy())
    assert len(shown) == 3 * 4  # experts, rollouts, replay
    assert {len(step.features.element_tag) for step in sources["replay"][1]} == {len(FLAT)}


def imitator(form: str) -> SoftQ:
    draw = np.random.default_rng(0)
    torch.manual_seed(0)
    config = SoftQConfig(updates=8, batch=16, learning_rate=3e-3)
    return SoftQ(config, form, policy(), Replay(100, draw), draw, metrics=Metrics())


@pytest.mark.parametrize("form", ["sqil", "iq_learn"])
def test_soft_q_learning_does_what_experts_do_and_values_it_as_the_rule_says(form: str) -> None:
    learner = imitator(form)
    right = study(trajectory(GOAL, [SHORT], [RIGHT]), vectors())
    others = [a for a in legal_actions(SHORT, Goal(GOAL)) if a != RIGHT]
    wrong = [study(trajectory(GOAL, [SHORT], [action]), vectors()) for action in others]
    for _ in range(25):
        stats = learner.update([right], wrong)
    with torch.no_grad():
        logp, _, _ = learner.net.evaluate(*collate_steps(steps_of([right])))
    assert logp.exp().item() > 0.8
    assert stats["p_implied_expert"] > stats["p_implied_rollouts"] + 0.3
    if form == "sqil":
        assert stats["p_implied_expert"] == pytest.approx(1.0, abs=0.3)
        assert stats["p_implied_rollouts"] == pytest.approx(0.0, abs=0.3)


def test_the_value_ahead_is_that_of_the_following_page_and_nothing_after_the_end() -> None:
    learner = imitator("sqil")
    two = study(trajectory(GOAL, [SHORT, FLAT], [RIGHT, Action(verb=Verb.CLICK, element=0)]), vectors())
    first, second = steps_of([two])
    ahead = learner._values_ahead([second, None], learned=False)
    batch, _ = collate_steps([second])
    assert first is not second
    assert ahead.tolist() == [pytest.approx(learner.net.worth(batch).item()), 0.0]
    assert not ahead.requires_grad
    assert learner._values_ahead([second], learned=True).requires_grad


class Recorder:
    """A learner all of whose parts answer with their names."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        part = self._part
        self.study, self.told = part("study"), part("told")
        self.demos = SimpleNamespace(sample=part("expert"))
        self.discriminator = SimpleNamespace(update=part("d_update"), rewards=part("rewards"), ask="ask")
        self.policy = SimpleNamespace(update=part("p_update"), net="net")
        self.cloner = SimpleNamespace(update=part("clone"))
        self.soft_q = SimpleNamespace(update=part("soft_q"))

    def _part(self, name: str) -> Any:
        def call(*given: Any, **named: Any) -> Any:
            self.calls.append(f"{name}({', '.join(str(each) for each in given)})")
            return name

        return call


@pytest.mark.parametrize(
    ("algorithm", "calls"),
    [
        ("frozen", ["study(take)", "rewards(study)", "p_update(study, rewards, ask)"]),
        ("true_reward", ["study(take)", "told(study)", "p_update(study, told, None)"]),
        ("sqil", ["study(take)", "expert(64)", "soft_q(expert, study)"]),
        ("iq_learn", ["study(take)", "expert(64)", "soft_q(expert, study)"]),
    ],
)
def test_each_baseline_uses_what_it_may_and_nothing_else(algorithm: str, calls: list[str]) -> None:
    learner: Any = Recorder()
    source: Any = SimpleNamespace(take=lambda episodes: "take")
    ALGORITHMS[algorithm](Config(), learner, source, range(1), lambda step, stats: None)
    assert learner.calls == calls


def test_about_the_asked_share_of_goals_is_held_out_and_case_makes_no_other_goal() -> None:
    goals = [Goal(f'Click on the "word{number}" button.') for number in range(2_000)]
    held = [is_held_out(goal, 0.25) for goal in goals]
    assert 0.2 < np.mean(held) < 0.3
    assert held == [is_held_out(Goal(goal.utterance.replace("word", "WORD")), 0.25) for goal in goals]
    assert not any(is_held_out(goal, 0.0) for goal in goals)
