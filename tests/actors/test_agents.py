"""Agents: what they choose, with which probability, and the actions that they sample for the policy update."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from actors.agents import Decision, ExpertAgent, PolicyAgent, RandomAgent, ReplayAgent
from browser_farm.experts import expert
from browser_farm.fake import FakeFarm
from giirl_core.nets.parameters import serialise_net
from giirl_core.types import (
    EpisodeSpec,
    Goal,
    Observation,
    Verb,
)
from tests.actors.test_rollouts import FirstLeafAgent, episodes
from tests.learner.samples import SHORT, legal_actions, policy, vectors


def test_experts_always_succeed_on_the_fake_tasks() -> None:
    played = episodes(FakeFarm(tabs=4), ExpertAgent(expert), 40)
    assert all(episode.outcome.success for episode in played)
    assert {episode.trajectory.policy_version for episode in played} == {-1}


def test_random_agent_chooses_every_legal_action_with_the_probability_it_reports() -> None:
    goal = Goal("Type ok.")
    observation = Observation(episode=EpisodeSpec(task="t", seed=0), page=SHORT, goal=goal)
    uniform = np.random.default_rng(0).random((8000, 1, 3), dtype=np.float32)
    decisions = RandomAgent().select_actions([observation] * 8000, uniform)
    counts = Counter(decision.action for decision in decisions)
    reported = {decision.action: np.exp(decision.logp) for decision in decisions}
    assert set(counts) == set(legal_actions(SHORT, goal))
    assert sum(reported.values()) == pytest.approx(1.0)
    for action, p in reported.items():
        assert counts[action] / 8000 == pytest.approx(p, abs=0.02)


@pytest.mark.parametrize("uniform", [0.0, 1.0 - 2.0**-24])
def test_random_actions_are_legal_at_both_ends_of_the_unit_interval(uniform: float) -> None:
    goal = Goal("Type ok.")
    observation = Observation(episode=EpisodeSpec(task="t", seed=0), page=SHORT, goal=goal)
    (decision,) = RandomAgent().select_actions([observation], np.full((1, 1, 3), uniform, dtype=np.float32))
    assert decision.action in legal_actions(SHORT, goal)


def test_a_greedy_policy_does_not_depend_on_the_random_numbers() -> None:
    greedy = PolicyAgent(policy(), vectors(), greedy=True)
    observations = list(FakeFarm(tabs=1).reset({0: EpisodeSpec(task="click-button", seed=1)}).values())
    one, two = (
        greedy.select_actions(observations, np.full((1, 1, 3), uniform, dtype=np.float32)) for uniform in (0.01, 0.99)
    )
    assert one == two


def test_a_policy_agent_rejects_older_weights_and_reports_its_version() -> None:
    agent = PolicyAgent(policy(), vectors())
    agent.load(serialise_net(policy(1), 5))
    with pytest.raises(ValueError, match="version 4, wanted 5 or later"):
        agent.load(serialise_net(policy(2), 4))
    observations = list(FakeFarm(tabs=1).reset({0: EpisodeSpec(task="click-test", seed=1)}).values())
    (decision,) = agent.select_actions(observations, np.full((1, 1, 3), 0.5, dtype=np.float32))
    assert decision.version == 5


def test_a_training_agent_samples_actions_for_every_step_and_a_greedy_one_none() -> None:
    agent = PolicyAgent(policy(), vectors(), sampled_actions=6)
    for finished in episodes(FakeFarm(tabs=4), agent, 3):
        sampled = finished.trajectory.sampled
        assert sampled is not None
        assert sampled.choices.shape == (len(finished.trajectory), 6, 4)
        assert not sampled.rewards.any()
        rewards = np.arange(finished.trajectory.reward_count, dtype=np.float32)
        scored = finished.trajectory.with_rewards(rewards, 3)
        assert scored.sampled is not None
        assert scored.rewards.tolist() == rewards[::7].tolist()
        assert scored.sampled.rewards[0].tolist() == [1, 2, 3, 4, 5, 6]
    greedy = episodes(FakeFarm(tabs=4), PolicyAgent(policy(), vectors(), greedy=True), 1)
    assert all(finished.trajectory.sampled is None for finished in greedy)


def test_blind_replay_repeats_the_demonstration_with_the_nearest_instruction() -> None:
    shown = [finished.trajectory for finished in episodes(FakeFarm(tabs=4), ExpertAgent(expert), 30)]
    same = episodes(FakeFarm(tabs=4), ReplayAgent(shown), 30)
    assert sum(finished.outcome.success for finished in same) > 0.8 * len(same)
    few = [next(one for one in shown if one.task == task) for task in {one.task for one in shown}]
    won: Counter[str] = Counter()
    for finished in episodes(FakeFarm(tabs=4), ReplayAgent(few), 30):
        won[finished.trajectory.task] += finished.outcome.success
    assert won["click-test"] == 30
    assert won["enter-text"] < 5  # it types the name of its only demonstration
    with pytest.raises(ValueError, match="there is no demonstration of 'click-test' to replay"):
        episodes(FakeFarm(tabs=1), ReplayAgent([]), 1)


def test_a_replay_goes_on_where_a_page_does_not_change_and_waits_after_its_end() -> None:
    farm = FakeFarm(tabs=1)
    (page,) = farm.reset({0: EpisodeSpec(task="enter-text", seed=1)}).values()
    (demonstration,) = episodes(farm, ExpertAgent(expert), 1, tasks=["enter-text"])
    seen = [replace(page, step=step) for step in (0, 1, 0, 2)]  # an episode that is lost begins again at 0
    decisions = ReplayAgent([demonstration.trajectory]).select_actions(seen, np.zeros((4, 1, 3), dtype=np.float32))
    assert [one.action.verb for one in decisions] == [Verb.TYPE, Verb.CLICK, Verb.TYPE, Verb.WAIT]


class CountingAgent(FirstLeafAgent):
    """Notes the steps of the episodes that it acts in."""

    def __init__(self) -> None:
        self.steps: dict[EpisodeSpec, list[int]] = {}

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        for observation in observations:
            self.steps.setdefault(observation.episode, []).append(observation.step)
        return super().select_actions(observations, uniform)


def test_an_agent_sees_the_step_of_each_episode() -> None:
    agent = CountingAgent()
    episodes(FakeFarm(tabs=3), agent, 5, tasks=["enter-text"])
    assert list(agent.steps.values()) == [list(range(5))] * 5
