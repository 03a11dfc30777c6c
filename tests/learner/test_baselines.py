"""The baselines and variants of GIIRL: their update rules, and the data that each of them may use."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import pytest
import torch

from giirl_core.config import Config, DiscriminatorConfig, SoftQConfig
from giirl_core.metrics import Metrics
from giirl_core.nets.augment import rename
from giirl_core.nets.batch import Batch
from giirl_core.nets.models import PolicyNet
from giirl_core.nets.reward import RewardModel, episode_rewards
from giirl_core.types import Action, Goal, Verb
from learner.algorithms import LOOPS
from learner.data import Replay, collate_steps, featurise_trajectory, last_step, steps_of
from learner.discriminator import Discriminator
from learner.soft_q import SoftQ
from tests.learner.samples import (
    FLAT,
    SHORT,
    legal_actions,
    policy,
    reward_net,
    trajectory,
    vectors,
)

GOAL = "Type ok."
RIGHT = Action(verb=Verb.TYPE, element=1, start=1, end=1)


def test_the_goal_reward_rewards_only_the_last_step_of_an_episode() -> None:
    logits = torch.tensor([4.0, -1.0, 2.0, 3.0, -2.0])
    parts = episode_rewards(logits, [3, 2], "goal", 5.0)
    assert [part.tolist() for part in parts] == [[0.0, 0.0, 1.0], [0.0, 0.0]]
    assert [len(part) for part in episode_rewards(logits, [3, 2], "logit", 5.0)] == [3, 2]


def test_a_discriminator_of_final_steps_samples_only_last_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    examples: list[Any] = []

    def record(example: Any, rng: Any) -> Any:
        examples.append(example)
        return last_step(example, rng)

    monkeypatch.setattr("learner.discriminator.last_step", record)
    config = replace(DiscriminatorConfig(), train_on="final_steps", batch=4, rollouts=1.0, replay=1.0)
    rng = np.random.default_rng(0)
    demos: Any = SimpleNamespace(wrong_goals=lambda expert: [])
    model: Any = SimpleNamespace(net=torch.nn.Linear(1, 1), device=torch.device("cpu"))
    discriminator = Discriminator(
        config, model, demos, Replay(4, rng), rng, torch.Generator(), reward_lag=1, metrics=Metrics()
    )
    long = featurise_trajectory(trajectory(GOAL, [SHORT, FLAT], [RIGHT, Action(verb=Verb.CLICK, element=0)]), vectors())
    discriminator.replay.add([long])
    samples = discriminator._sample_sources([long], [long], policy())
    assert len(examples) == 4 + 1 + 4  # expert, rollouts, replay
    weight, pages, column = samples.sources["replay"]
    assert (weight, column) == (1.0, 0)
    assert set(samples.batch.clickable[pages].sum(1).tolist()) == {len(FLAT)}


def make_discriminator(config: DiscriminatorConfig) -> Discriminator:
    rng, noise = np.random.default_rng(0), torch.Generator().manual_seed(0)
    demos: Any = SimpleNamespace(wrong_goals=lambda expert: [])
    model = RewardModel(reward_net(), vectors(), "logit", 100.0)
    return Discriminator(config, model, demos, Replay(4, rng), rng, noise, reward_lag=1, metrics=Metrics())


def value_of(net: PolicyNet, batch: Batch) -> float:
    """V of the first page."""
    return net.state_value(net.encoder(batch))[0].item()


def make_soft_q(form: str) -> SoftQ:
    rng = np.random.default_rng(0)
    torch.manual_seed(0)
    config = SoftQConfig(updates=8, batch=16, learning_rate=3e-3)
    return SoftQ(config, form, policy(), Replay(100, rng), rng, torch.Generator(), metrics=Metrics())


@pytest.mark.parametrize("form", ["sqil", "iq_learn"])
def test_soft_q_learning_imitates_the_expert_and_implies_a_higher_reward_for_it(form: str) -> None:
    learner = make_soft_q(form)
    right = featurise_trajectory(trajectory(GOAL, [SHORT], [RIGHT]), vectors())
    others = [a for a in legal_actions(SHORT, Goal(GOAL)) if a != RIGHT]
    wrong = [featurise_trajectory(trajectory(GOAL, [SHORT], [action]), vectors()) for action in others]
    for _ in range(25):
        stats = learner.update([right], wrong)
    with torch.no_grad():
        batch, actions = collate_steps(steps_of([right]))
        logp, _ = learner.net.evaluate(learner.net.encoder(batch), actions)
    assert logp.exp().item() > 0.8
    assert stats["p_implied_expert"] > stats["p_implied_rollouts"] + 0.3
    if form == "sqil":
        assert stats["p_implied_expert"] == pytest.approx(1.0, abs=0.3)
        assert stats["p_implied_rollouts"] == pytest.approx(0.0, abs=0.3)


def test_q_learning_finds_the_action_with_the_highest_reward_and_samples_errors_more_often() -> None:
    learner = make_soft_q("q_learning")
    right = trajectory(GOAL, [SHORT], [RIGHT])
    right = replace(right, rewards=np.ones(1, np.float32))
    others = [a for a in legal_actions(SHORT, Goal(GOAL)) if a != RIGHT]
    wrong = [trajectory(GOAL, [SHORT], [action]) for action in others]
    rollouts = [featurise_trajectory(one, vectors()) for one in (right, *wrong)]
    learner.update([], rollouts)
    for _ in range(40):
        learner.update([], [])
    with torch.no_grad():
        batch, actions = collate_steps(steps_of(rollouts))
        logp, _ = learner.net.evaluate(learner.net.encoder(batch), actions)
    assert int(logp.squeeze(1).argmax()) == 0
    learner.replay.priorities = [1.0] + [0.01] * len(wrong)
    chosen, weights = learner.replay.sample_by_priority(500)
    assert chosen.count(0) > 200
    assert weights[chosen.index(0)] == weights.min() < weights.max() == 1.0


@pytest.mark.parametrize("form", ["sqil", "iq_learn"])
def test_the_next_value_is_that_of_the_next_page_and_0_after_the_end(form: str) -> None:
    learner = make_soft_q(form)
    two = featurise_trajectory(trajectory(GOAL, [SHORT, FLAT], [RIGHT, Action(verb=Verb.CLICK, element=0)]), vectors())
    first, second = steps_of([two])
    batch, _ = collate_steps([second, first])
    ahead = learner._next_values(batch, torch.tensor([True, False]))
    assert ahead.tolist() == [pytest.approx(value_of(learner.net, batch)), 0.0]
    assert ahead.requires_grad is (form == "iq_learn")
    learner.update([two], [two])
    later = learner._next_values(batch, torch.tensor([True, False]))
    now, slow = (value_of(net, batch) for net in (learner.net, learner.target))
    assert later[0].item() == pytest.approx(slow)
    moved, followed = abs(now - ahead[0].item()), abs(slow - ahead[0].item())
    assert 0 < followed < moved if form == "sqil" else followed == moved > 0  # SQIL's target net is a slow copy


def test_the_next_value_in_q_learning_is_the_highest_q_and_has_no_entropy() -> None:
    learner = make_soft_q("q_learning")
    actions = legal_actions(SHORT, Goal(GOAL))
    examples = [featurise_trajectory(trajectory(GOAL, [SHORT], [action]), vectors()) for action in actions]
    batch, chosen = collate_steps(steps_of(examples))
    ahead = learner._next_values(batch, torch.ones(len(actions), dtype=torch.bool))
    with torch.no_grad():
        logp, entropy = learner.net.evaluate(learner.net.encoder(batch), chosen)
    q = value_of(learner.net, batch) + learner.config.temperature * logp.squeeze(1)
    assert ahead[0].item() == pytest.approx(q.max().item())
    assert entropy[0] > 1


def test_both_pages_of_a_transition_get_the_same_new_words(monkeypatch: pytest.MonkeyPatch) -> None:
    renamed: list[Batch] = []

    def record(*args: Any) -> Batch:
        renamed.append(rename(*args))
        return renamed[-1]

    monkeypatch.setattr("learner.soft_q.rename", record)
    learner = make_soft_q("sqil")
    twice = featurise_trajectory(trajectory(GOAL, [SHORT, SHORT], [RIGHT, RIGHT]), vectors())
    learner.update([twice], [twice])
    current, following = renamed[:2]
    assert torch.equal(current.token_words, following.token_words)
    assert torch.equal(current.text_words, following.text_words)
    assert len(current.token_words.unique()) > len(GOAL.split())


def test_the_accuracy_is_a_slow_average_over_expert_and_rollouts() -> None:
    discriminator = make_discriminator(DiscriminatorConfig(rename_prob=0.0))
    long = featurise_trajectory(trajectory(GOAL, [SHORT], [RIGHT]), vectors())
    before = discriminator.accuracy
    stats = discriminator.update([long], [long], policy())
    both = (stats["d_accuracy_expert"] + stats["d_accuracy_rollouts"]) / 2
    assert both == pytest.approx(0.5)  # the same pair on both sides
    assert discriminator.accuracy == pytest.approx(before + 0.05 * (both - before))


class Recorder:
    """A learner whose parts record their calls and return their names."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        part = self._part
        self.featurise, self.carried_rewards = part("featurise"), part("carried_rewards")
        self.demos = SimpleNamespace(sample=part("expert"))
        self.discriminator = SimpleNamespace(update=part("d_update"), rewards=part("rewards"))
        self.policy = SimpleNamespace(update=part("p_update"), net="net")
        self.cloner = SimpleNamespace(update=part("clone"))
        self.soft_q = SimpleNamespace(update=part("soft_q"))
        self.successes = part("successes")
        self.replay = SimpleNamespace(add=part("add"), sample=part("replayed"))

    def _part(self, name: str) -> Any:
        def call(*args: Any, **kwargs: Any) -> Any:
            self.calls.append(f"{name}({', '.join(map(str, args))})")
            return name

        return call


@pytest.mark.parametrize(
    ("algorithm", "calls"),
    [
        (
            "frozen",
            [
                "featurise(take)",
                "rewards(featurise)",
                "p_update(featurise, rewards)",
            ],
        ),
        (
            "true_reward",
            ["featurise(take)", "carried_rewards(featurise)", "p_update(featurise, carried_rewards)"],
        ),
        ("cloning", ["expert(64)", "clone(expert)", "expert(64)", "clone(expert)"]),
        ("sqil", ["featurise(take)", "expert(64)", "soft_q(expert, featurise)"]),
        ("iq_learn", ["featurise(take)", "expert(64)", "soft_q(expert, featurise)"]),
        ("q_learning", ["featurise(take)", "soft_q([], featurise)"]),
        (
            "wge",
            [
                "featurise(take)",
                "carried_rewards(featurise)",
                "p_update(featurise, carried_rewards)",
                "successes(featurise)",
                "add(successes)",
                *["replayed(64)", "clone(replayed)"] * 2,
            ],
        ),
    ],
)
def test_each_baseline_uses_only_the_data_it_may(algorithm: str, calls: list[str]) -> None:
    learner: Any = Recorder()
    source: Any = SimpleNamespace(take=lambda episodes: "take")
    LOOPS[algorithm](Config(), learner, source, range(1), lambda step, stats: None)
    assert learner.calls == calls


@pytest.mark.parametrize("form", ["plain", "airl"])
def test_the_optimal_airl_reward_is_log_pi_where_expert_and_policy_act_alike(form: Literal["plain", "airl"]) -> None:
    """If both act alike, D = 1/2 and the logit is 0. AIRL's logit is f - log pi, so f = log pi. Plain, f = 0."""
    none = {"rollouts": 0.0, "replay": 0.0, "random_actions": 0.0, "wrong_goal": 0.0, "rename_prob": 0.0}
    config = DiscriminatorConfig(form=form, updates=1, batch=32, policy_on_expert_states=1.0, **none)  # type: ignore[arg-type]
    net = policy()
    actions = legal_actions(SHORT, Goal(GOAL))
    batch, every = collate_steps(
        steps_of([featurise_trajectory(trajectory(GOAL, [SHORT], [a]), vectors()) for a in actions])
    )
    with torch.no_grad():
        logp = net.evaluate(net.encoder(batch), every)[0].squeeze(1)
    discriminator = make_discriminator(config)
    noise = torch.Generator().manual_seed(0)
    played = torch.multinomial(logp.exp(), 400, replacement=True, generator=noise).tolist()
    expert = [featurise_trajectory(trajectory(GOAL, [SHORT], [actions[i]]), vectors()) for i in played]
    for start in range(0, 400, 32):
        discriminator.update(expert[start : start + 32], expert[:1], net)
        discriminator.update(expert[start : start + 32], expert[:1], net)
    with torch.no_grad():
        learned = discriminator.model.net(batch, every).squeeze(1)
    frequent = logp > logp.max() - 3
    gap = (learned - (logp if form == "airl" else 0.0))[frequent].abs().mean().item()
    wrong = (learned - (0.0 if form == "airl" else logp))[frequent].abs().mean().item()
    assert gap < wrong
