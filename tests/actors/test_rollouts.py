"""Episodes out of tabs: the seed decides them, the limit ends them, and what is lost is played again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from prometheus_client import generate_latest

from actors.agents import Agent, Decision, ExpertAgent, PolicyAgent, RandomAgent
from actors.rollouts import Schedule, play
from browser_farm.experts import expert
from browser_farm.fake import TASKS, FakeFarm, check_task
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import seal_net
from giirl_core.types import (
    Action,
    Browser,
    Command,
    Episode,
    EpisodeSpec,
    Goal,
    Observation,
    Page,
    Purpose,
    StepResult,
    Verb,
    page_seed,
)
from tests.learner.samples import SHORT, legal_actions, policy, vectors

ALL = tuple(TASKS)
EMPTY = Page(
    tag=(),
    text=(),
    value=(),
    classes=(),
    ref=np.zeros(0, dtype=np.int32),
    parent=np.zeros(0, dtype=np.int16),
    box=np.zeros((0, 4), dtype=np.float32),
    focused=np.zeros(0, dtype=np.bool_),
    tampered=np.zeros(0, dtype=np.bool_),
)


def episodes(
    browser: Browser, chooser: Agent, quota: int, *, tasks: Sequence[str] = ALL, limit: int = 5, first: int = 0
) -> list[Episode]:
    """Played to the end, in order of task and seed."""
    schedule = Schedule(tasks, browser.tabs, purpose=Purpose.TRAIN, run_seed=3, quota=quota, first=first)
    rounds = play(browser, chooser, schedule, step_limit=limit, metrics=Metrics())
    done = [episode for ended in rounds for episode in ended]
    return sorted(done, key=lambda episode: (episode.trajectory.task, episode.trajectory.seed))


class Losing(FakeFarm):
    """Breaks off every third step, as a browser that dies does, and goes on with the next episode."""

    def __init__(self, *, tabs: int, times: int) -> None:
        super().__init__(tabs=tabs)
        self.left, self._steps = times, 0

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        results = {}
        for tab, command in commands.items():
            self._steps += 1
            if self.left and self._steps % 3 == 0:
                self.left -= 1
                following = command.following
                seen = None if following is None else self.reset({tab: following})[tab]
                results[tab] = StepResult(raw_reward=1.0, done=True, observation=seen, lost="the tab crashed")
            else:
                results |= super().step({tab: command})
        return results


class Blank(FakeFarm):
    """Shows nothing at all at even seeds, and after the first action at seeds that four divides with rest 1."""

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        return {tab: self._emptied(seen, acted=False) for tab, seen in super().reset(episodes).items()}

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        results = super().step(commands)
        for tab, result in results.items():
            if result.observation is not None:
                acted = not (result.done or commands[tab].last)
                results[tab] = replace(result, observation=self._emptied(result.observation, acted))
        return results

    def _emptied(self, seen: Observation, acted: bool) -> Observation:
        blank = seen.episode.seed % 2 == 0 or (acted and seen.episode.seed % 4 == 1)
        return replace(seen, page=EMPTY) if blank else seen


class Stubborn:
    """Clicks the first leaf for ever."""

    def __call__(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        first = [int(np.flatnonzero(seen.page.leaf)[0]) for seen in observations]
        return [Decision(Action(verb=Verb.CLICK, element=element), -0.25, 4) for element in first]


def story(episode: Episode) -> tuple[object, ...]:
    """What happened, without the rounding of probabilities."""
    told = episode.trajectory
    return told.task, told.seed, told.goal, told.actions, episode.outcome, [page.value for page in told.pages]


@pytest.mark.parametrize("tabs", [2, 3, 8])
def test_the_seeds_decide_every_episode_whatever_the_number_of_tabs(tabs: int) -> None:
    one = episodes(FakeFarm(tabs=1), PolicyAgent(policy(), vectors()), 6)
    more = episodes(FakeFarm(tabs=tabs), PolicyAgent(policy(), vectors()), 6)
    assert len(one) == 6 * len(ALL)
    assert [story(episode) for episode in more] == [story(episode) for episode in one]
    for a, b in zip(one, more, strict=True):
        np.testing.assert_allclose(a.trajectory.behaviour_logp, b.trajectory.behaviour_logp, atol=1e-4)


def test_other_episodes_come_when_the_count_goes_on() -> None:
    early = episodes(FakeFarm(tabs=4), RandomAgent(), 3)
    late = episodes(FakeFarm(tabs=4), RandomAgent(), 3, first=3)
    wanted = {page_seed(Purpose.TRAIN, 3, i) for i in range(6)}
    for task in ALL:
        seeds = [e.trajectory.seed for e in early + late if e.trajectory.task == task]
        assert set(seeds) == wanted
        assert len(seeds) == 6


def test_the_step_limit_ends_an_episode_that_the_page_does_not() -> None:
    done = episodes(FakeFarm(tabs=2), Stubborn(), 3, tasks=("enter-text",), limit=4)
    assert [len(episode.trajectory) for episode in done] == [4, 4, 4]
    assert not any(episode.outcome.ended or episode.outcome.success for episode in done)
    assert done[0].trajectory.policy_version == 4
    assert done[0].trajectory.behaviour_logp.tolist() == [-0.25] * 4
    assert done[0].trajectory.pages[-1].tampered.tolist() == [True, False]


def test_a_page_that_ends_within_the_limit_has_no_step_more() -> None:
    done = episodes(FakeFarm(tabs=2), Stubborn(), 3, tasks=("click-test-2",), limit=4)
    assert [len(episode.trajectory) for episode in done] == [1, 1, 1]
    assert all(episode.outcome.success and episode.outcome.ended for episode in done)


@pytest.mark.parametrize("tabs", [1, 3, 8])
def test_lost_episodes_are_played_again_and_leave_no_other_trace(tabs: int) -> None:
    browser = Losing(tabs=tabs, times=2)
    chooser = ExpertAgent(expert)
    got = [story(episode) for episode in episodes(browser, chooser, 4)]
    assert browser.left == 0
    assert got == [story(episode) for episode in episodes(FakeFarm(tabs=tabs), chooser, 4)]


@pytest.mark.parametrize("tabs", [1, 3])
def test_a_page_with_nothing_to_act_on_ends_its_episode_with_what_was_done_before(tabs: int) -> None:
    done = episodes(Blank(tabs=tabs), Stubborn(), 8, tasks=("enter-text",), limit=4)
    assert [(episode.trajectory.seed % 4, len(episode.trajectory)) for episode in done] == [(1, 1), (3, 4)] * 2


def test_lost_episodes_are_counted_as_such() -> None:
    metrics = Metrics()
    schedule = Schedule(("click-test",), 2, purpose=Purpose.TRAIN, run_seed=0, quota=6)
    rounds = play(Losing(tabs=2, times=2), ExpertAgent(expert), schedule, step_limit=5, metrics=metrics)
    assert sum(map(len, rounds)) == 6
    exposed = generate_latest(metrics.registry).decode()
    assert 'giirl_episodes_total{outcome="lost",task="click-test"} 2.0' in exposed
    assert 'giirl_episodes_total{outcome="success",task="click-test"} 6.0' in exposed


def test_an_episode_that_is_always_lost_is_given_up_and_the_others_are_played() -> None:
    cursed = page_seed(Purpose.TRAIN, 0, 2)

    class Cursed(FakeFarm):
        def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
            ending = {tab for tab in commands if self._open[tab].episode.seed == cursed}
            results = super().step(commands)
            return {tab: replace(r, lost="page_hung") if tab in ending else r for tab, r in results.items()}

    schedule = Schedule(("click-test",), 2, purpose=Purpose.TRAIN, run_seed=0, quota=6)
    rounds = play(Cursed(tabs=2), ExpertAgent(expert), schedule, step_limit=5, metrics=Metrics())
    played = [episode.trajectory.seed for some in rounds for episode in some]
    assert sorted(played) == [page_seed(Purpose.TRAIN, 0, i) for i in (0, 1, 3, 4, 5)]


@pytest.mark.parametrize("tabs", [1, 2, 3, 5, 9])
def test_a_quota_is_kept_by_every_task_on_any_number_of_tabs(tabs: int) -> None:
    played = episodes(FakeFarm(tabs=tabs), RandomAgent(), 7)
    assert Counter(episode.trajectory.task for episode in played) == dict.fromkeys(ALL, 7)
    assert len({(episode.trajectory.task, episode.trajectory.seed) for episode in played}) == 28


def test_a_schedule_without_a_quota_never_repeats_a_page_and_shares_tabs_between_tasks() -> None:
    schedule = Schedule(ALL, 2, purpose=Purpose.TRAIN, run_seed=0, first=1, stride=3)
    dealt = [schedule.next(i % 2) for i in range(400)]
    assert len(set(dealt)) == 400
    assert Counter(spec.task for spec in dealt if spec) == dict.fromkeys(ALL, 100)
    assert {spec.seed % 3 for spec in dealt if spec} == {page_seed(Purpose.TRAIN, 0, 1) % 3}


def test_an_episode_given_back_goes_to_a_tab_of_its_task_alone() -> None:
    schedule = Schedule(ALL, 4, purpose=Purpose.TRAIN, run_seed=0, quota=1)
    first = [schedule.next(tab) for tab in range(4)]
    assert [schedule.next(tab) for tab in range(4)] == [None] * 4
    lost = first[2]
    assert lost is not None
    schedule.give_back(lost)
    assert [schedule.next(tab) for tab in range(4)] == [None, None, lost, None]


def test_experts_always_succeed() -> None:
    played = episodes(FakeFarm(tabs=4), ExpertAgent(expert), 40)
    assert all(episode.outcome.success for episode in played)
    assert {episode.trajectory.policy_version for episode in played} == {-1}


def test_chance_chooses_every_legal_action_as_often_as_it_says() -> None:
    goal = Goal("Type ok.")
    seen = Observation(episode=EpisodeSpec(task="t", seed=0), page=SHORT, goal=goal)
    uniform = np.random.default_rng(0).random((8000, 3), dtype=np.float32)
    chosen = RandomAgent()([seen] * 8000, uniform)
    counts = Counter(choice.action for choice in chosen)
    told = {choice.action: np.exp(choice.logp) for choice in chosen}
    assert set(counts) == set(legal_actions(SHORT, goal))
    assert sum(told.values()) == pytest.approx(1.0)
    for action, p in told.items():
        assert counts[action] / 8000 == pytest.approx(p, abs=0.02)


@pytest.mark.parametrize("uniform", [0.0, 1.0 - 2.0**-24])
def test_chance_is_legal_at_both_ends_of_its_draws(uniform: float) -> None:
    goal = Goal("Type ok.")
    seen = Observation(episode=EpisodeSpec(task="t", seed=0), page=SHORT, goal=goal)
    (choice,) = RandomAgent()([seen], np.full((1, 3), uniform, dtype=np.float32))
    assert choice.action in legal_actions(SHORT, goal)


def test_a_greedy_policy_does_not_depend_on_chance() -> None:
    greedy = PolicyAgent(policy(), vectors(), greedy=True)
    seen = list(FakeFarm(tabs=1).reset({0: EpisodeSpec(task="click-button", seed=1)}).values())
    one, two = (greedy(seen, np.full((1, 3), uniform, dtype=np.float32)) for uniform in (0.01, 0.99))
    assert one == two


def test_a_chooser_refuses_older_weights_and_says_which_version_chose() -> None:
    chooser = PolicyAgent(policy(), vectors())
    chooser.load(seal_net(policy(1), 5))
    with pytest.raises(ValueError, match="version 4 is older than 5"):
        chooser.load(seal_net(policy(2), 4))
    seen = list(FakeFarm(tabs=1).reset({0: EpisodeSpec(task="click-test", seed=1)}).values())
    (choice,) = chooser(seen, np.full((1, 3), 0.5, dtype=np.float32))
    assert choice.version == 5


@pytest.mark.parametrize("task", ALL)
def test_the_same_task_and_seed_show_the_same_fake_page(task: str) -> None:
    spec = EpisodeSpec(task=task, seed=99)
    one, two, three = (FakeFarm(tabs=1).reset({0: s})[0] for s in (spec, spec, replace(spec, seed=98)))
    assert one.goal == two.goal
    assert one.page.text == two.page.text
    assert np.array_equal(one.page.box, two.page.box)
    assert not np.array_equal(one.page.box, three.page.box)


def test_an_unknown_fake_task_names_those_there_are() -> None:
    with pytest.raises(ValueError, match="no task 'click-buton': it has click-test"):
        check_task("click-buton")
