"""Rollouts: an episode depends on its seed alone, the step limit ends it, and a lost episode is played again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from prometheus_client import generate_latest

from actors.agents import Agent, Decision, ExpertAgent, PolicyAgent, RandomAgent
from actors.rollouts import always_open, play
from actors.schedule import Schedule
from browser_farm.experts import expert
from browser_farm.fake import TASKS, FakeFarm, check_task
from giirl_core.metrics import Metrics
from giirl_core.types import (
    Action,
    Browser,
    Command,
    Episode,
    EpisodeSpec,
    Observation,
    Page,
    Purpose,
    StepResult,
    Verb,
    page_seed,
)
from tests.actors.faulty_farm import FaultyFarm
from tests.learner.samples import policy, vectors

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
    browser: Browser, agent: Agent, quota: int, *, tasks: Sequence[str] = ALL, limit: int = 5, first: int = 0
) -> list[Episode]:
    """Play a whole schedule; returns its episodes in order of task and seed."""
    schedule = Schedule(tasks, browser.tabs, purpose=Purpose.TRAIN, run_seed=3, quota=quota, first=first)
    rounds = play(browser, agent, schedule, step_limit=limit, metrics=Metrics())
    done = [episode for ended in rounds for episode in ended]
    return sorted(done, key=lambda episode: (episode.trajectory.task, episode.trajectory.seed))


class LosingBrowser(FakeFarm):
    """Loses the episode at every third step, as a crashed tab does, and continues with the next episode."""

    def __init__(self, *, tabs: int, times: int) -> None:
        super().__init__(tabs=tabs)
        self.losses_left, self._steps = times, 0

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        results = {}
        for tab, command in commands.items():
            self._steps += 1
            if self.losses_left and self._steps % 3 == 0:
                self.losses_left -= 1
                following = command.following
                observation = None if following is None else self.reset({tab: following})[tab]
                results[tab] = StepResult(raw_reward=1.0, done=True, observation=observation, lost="the tab crashed")
            else:
                results |= super().step({tab: command})
        return results


class BlankPages(FakeFarm):
    """Shows an empty page where the seed is even, and after the first action where the seed is 1 modulo 4."""

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        return {tab: self._blank(observation, acted=False) for tab, observation in super().reset(episodes).items()}

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        results = super().step(commands)
        for tab, result in results.items():
            if result.observation is not None:
                acted = not (result.done or commands[tab].last)
                results[tab] = replace(result, observation=self._blank(result.observation, acted))
        return results

    def _blank(self, observation: Observation, acted: bool) -> Observation:
        seed = observation.episode.seed
        return replace(observation, page=EMPTY) if seed % 2 == 0 or (acted and seed % 4 == 1) else observation


class FirstLeafAgent:
    """Always clicks the first leaf."""

    draws = 1

    def select_actions(self, observations: Sequence[Observation], uniform: NDArray[np.float32]) -> list[Decision]:
        first = [int(np.flatnonzero(observation.page.leaf)[0]) for observation in observations]
        return [Decision(Action(verb=Verb.CLICK, element=element), -0.25, 4) for element in first]


def content(episode: Episode) -> tuple[object, ...]:
    """What happened in an episode, without the log-probabilities, which depend on the batch through rounding."""
    t = episode.trajectory
    return t.task, t.seed, t.goal, t.actions, episode.outcome, [page.value for page in t.pages]


@pytest.mark.parametrize("tabs", [2, 3, 8])
def test_every_episode_depends_on_its_seed_and_not_on_the_number_of_tabs(tabs: int) -> None:
    one = episodes(FakeFarm(tabs=1), PolicyAgent(policy(), vectors()), 6)
    more = episodes(FakeFarm(tabs=tabs), PolicyAgent(policy(), vectors()), 6)
    assert len(one) == 6 * len(ALL)
    assert [content(episode) for episode in more] == [content(episode) for episode in one]
    for a, b in zip(one, more, strict=True):
        np.testing.assert_allclose(a.trajectory.behaviour_logp, b.trajectory.behaviour_logp, atol=1e-4)


def test_a_schedule_with_a_later_first_index_plays_other_episodes() -> None:
    early = episodes(FakeFarm(tabs=4), RandomAgent(), 3)
    late = episodes(FakeFarm(tabs=4), RandomAgent(), 3, first=3)
    wanted = {page_seed(Purpose.TRAIN, 3, i) for i in range(6)}
    for task in ALL:
        seeds = [e.trajectory.seed for e in early + late if e.trajectory.task == task]
        assert set(seeds) == wanted
        assert len(seeds) == 6


def test_the_step_limit_ends_an_episode_that_the_page_does_not_end() -> None:
    done = episodes(FakeFarm(tabs=2), FirstLeafAgent(), 3, tasks=("enter-text",), limit=4)
    assert [len(episode.trajectory) for episode in done] == [4, 4, 4]
    assert not any(episode.outcome.ended or episode.outcome.success for episode in done)
    assert done[0].trajectory.policy_version == 4
    assert done[0].trajectory.behaviour_logp.tolist() == [-0.25] * 4
    assert done[0].trajectory.pages[-1].tampered.tolist() == [True, False]


def test_an_episode_that_the_page_ends_has_no_further_step() -> None:
    done = episodes(FakeFarm(tabs=2), FirstLeafAgent(), 3, tasks=("click-test-2",), limit=4)
    assert [len(episode.trajectory) for episode in done] == [1, 1, 1]
    assert all(episode.outcome.success and episode.outcome.ended for episode in done)


@pytest.mark.parametrize("tabs", [1, 3, 8])
def test_lost_episodes_are_played_again_with_the_same_result(tabs: int) -> None:
    browser = LosingBrowser(tabs=tabs, times=2)
    agent = ExpertAgent(expert)
    played = [content(episode) for episode in episodes(browser, agent, 4)]
    assert browser.losses_left == 0
    assert played == [content(episode) for episode in episodes(FakeFarm(tabs=tabs), agent, 4)]


@pytest.mark.parametrize("tabs", [1, 3])
def test_an_empty_page_ends_the_episode_and_the_steps_before_it_are_kept(tabs: int) -> None:
    done = episodes(BlankPages(tabs=tabs), FirstLeafAgent(), 8, tasks=("enter-text",), limit=4)
    assert [(episode.trajectory.seed % 4, len(episode.trajectory)) for episode in done] == [(1, 1), (3, 4)] * 2


def test_metrics_count_lost_episodes() -> None:
    metrics = Metrics()
    schedule = Schedule(("click-test",), 2, purpose=Purpose.TRAIN, run_seed=0, quota=6)
    rounds = play(LosingBrowser(tabs=2, times=2), ExpertAgent(expert), schedule, step_limit=5, metrics=metrics)
    assert sum(map(len, rounds)) == 6
    exposed = generate_latest(metrics.registry).decode()
    assert 'giirl_episodes_total{outcome="lost",purpose="train",task="click-test"} 2.0' in exposed
    assert 'giirl_episodes_total{outcome="success",purpose="train",task="click-test"} 6.0' in exposed


def test_an_episode_that_is_lost_every_time_is_abandoned_and_the_others_are_played() -> None:
    lost_seed = page_seed(Purpose.TRAIN, 0, 2)

    class LosesOneSeed(FakeFarm):
        def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
            lost = {tab for tab in commands if self._open[tab].episode.seed == lost_seed}
            results = super().step(commands)
            return {tab: replace(r, lost="page_hung") if tab in lost else r for tab, r in results.items()}

    schedule = Schedule(("click-test",), 2, purpose=Purpose.TRAIN, run_seed=0, quota=6)
    rounds = play(LosesOneSeed(tabs=2), ExpertAgent(expert), schedule, step_limit=5, metrics=Metrics())
    played = [episode.trajectory.seed for some in rounds for episode in some]
    assert sorted(played) == [page_seed(Purpose.TRAIN, 0, i) for i in (0, 1, 3, 4, 5)]


@pytest.mark.parametrize("tabs", [1, 2, 3, 5, 9])
def test_every_task_is_played_as_often_as_the_quota_for_any_number_of_tabs(tabs: int) -> None:
    played = episodes(FakeFarm(tabs=tabs), RandomAgent(), 7)
    assert Counter(episode.trajectory.task for episode in played) == dict.fromkeys(ALL, 7)
    assert len({(episode.trajectory.task, episode.trajectory.seed) for episode in played}) == 28


def test_a_schedule_without_a_quota_never_repeats_a_page_and_plays_all_tasks_equally_often() -> None:
    schedule = Schedule(ALL, 2, purpose=Purpose.TRAIN, run_seed=0, first=1, stride=3)
    specs = [schedule.next(i % 2) for i in range(400)]
    assert len(set(specs)) == 400
    assert Counter(spec.task for spec in specs if spec) == dict.fromkeys(ALL, 100)
    assert {spec.seed % 3 for spec in specs if spec} == {page_seed(Purpose.TRAIN, 0, 1) % 3}


def test_a_requeued_episode_goes_to_a_tab_of_its_task() -> None:
    schedule = Schedule(ALL, 4, purpose=Purpose.TRAIN, run_seed=0, quota=1)
    first = [schedule.next(tab) for tab in range(4)]
    assert [schedule.next(tab) for tab in range(4)] == [None] * 4
    lost = first[2]
    assert lost is not None
    schedule.requeue(lost)
    assert [schedule.next(tab) for tab in range(4)] == [None, None, lost, None]


@pytest.mark.parametrize("task", ALL)
def test_the_same_task_and_seed_give_the_same_fake_page(task: str) -> None:
    spec = EpisodeSpec(task=task, seed=99)
    one, two, three = (FakeFarm(tabs=1).reset({0: s})[0] for s in (spec, spec, replace(spec, seed=98)))
    assert one.goal == two.goal
    assert one.page.text == two.page.text
    assert np.array_equal(one.page.box, two.page.box)
    assert not np.array_equal(one.page.box, three.page.box)


def test_the_error_for_an_unknown_fake_task_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match="no task 'click-buton': it has click-test"):
        check_task("click-buton")


def test_episodes_start_only_as_the_gate_allows_and_are_the_same_ones() -> None:
    started: list[int] = []

    class Counting(FakeFarm):
        """Remembers how many tabs are open in each step."""

        def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
            started.append(len(commands))
            return super().step(commands)

    def played(browser: FakeFarm, gate: Callable[[int], int]) -> list[Episode]:
        schedule = Schedule(ALL, browser.tabs, purpose=Purpose.TRAIN, run_seed=3, quota=6)
        rounds = play(browser, RandomAgent(), schedule, step_limit=5, metrics=Metrics(), gate=gate)
        return sorted((e for some in rounds for e in some), key=lambda e: (e.trajectory.task, e.trajectory.seed))

    gated = played(Counting(tabs=8), lambda playing: 3 - playing)
    assert max(started) == 3
    assert [content(e) for e in gated] == [content(e) for e in played(FakeFarm(tabs=8), always_open)]


def test_a_closed_gate_yields_empty_rounds_until_it_opens() -> None:
    schedule = Schedule(["click-test"], 2, purpose=Purpose.TRAIN, run_seed=3, quota=2)
    opened = [False]
    gate = lambda playing: 2 - playing if opened[0] else 0  # noqa: E731
    rounds = play(FakeFarm(tabs=2), FirstLeafAgent(), schedule, step_limit=5, metrics=Metrics(), gate=gate)
    assert [next(rounds) for _ in range(3)] == [[], [], []]
    opened[0] = True
    assert sum(len(some) for some in rounds) == 2


@pytest.mark.parametrize("tabs", [1, 2, 3])
def test_an_episode_whose_page_does_not_open_is_played_again(tabs: int) -> None:
    left = [page_seed(Purpose.TRAIN, 3, i) for i in (0, 3, 0)]

    def closed(spec: EpisodeSpec) -> bool:
        if spec.seed in left:
            left.remove(spec.seed)
            return True
        return False

    agent = ExpertAgent(expert)
    played = episodes(FaultyFarm(tabs=tabs, closed=closed), agent, 6, tasks=("click-test",))
    assert left == []
    wanted = episodes(FakeFarm(tabs=tabs), agent, 6, tasks=("click-test",))
    assert [content(episode) for episode in played] == [content(episode) for episode in wanted]


@pytest.mark.parametrize("tabs", [1, 2, 3])
def test_a_page_that_never_opens_is_left_out_and_the_others_are_played(tabs: int) -> None:
    seeds = [page_seed(Purpose.TRAIN, 3, i) for i in range(6)]
    browser = FaultyFarm(tabs=tabs, closed=lambda spec: spec.seed in (seeds[1], seeds[4]))
    played = episodes(browser, ExpertAgent(expert), 6, tasks=("click-test",))
    assert [e.trajectory.seed for e in played] == [seeds[i] for i in (0, 2, 3, 5)]


@pytest.mark.parametrize("tabs", [1, 3])
def test_a_task_whose_pages_never_open_is_given_up_and_ends_a_training(tabs: int) -> None:
    def play_all(purpose: Purpose) -> list[Episode]:
        browser = FaultyFarm(tabs=tabs, closed=lambda spec: spec.task == "click-test")
        schedule = Schedule(("click-test", "click-test-2"), tabs, purpose=purpose, run_seed=0, quota=90)
        return [e for some in play(browser, RandomAgent(), schedule, step_limit=5, metrics=Metrics()) for e in some]

    assert Counter(episode.trajectory.task for episode in play_all(Purpose.EVALUATE)) == {"click-test-2": 90}
    with pytest.raises(RuntimeError, match=r"10 pages of click-test in a row did not open.*click-test does not open"):
        play_all(Purpose.TRAIN)
