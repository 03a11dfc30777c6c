"""Tasks of both kinds in one browser."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from browser_farm.fake import FakeFarm
from browser_farm.mixed import MixedFarm, check_task, expert_of
from giirl_core.types import Command, EpisodeSpec, Observation, StepResult, Verb

MINIWOB, SITE = EpisodeSpec(task="click-test", seed=1), EpisodeSpec(task="tasks/mine.toml", seed=2)


class SiteStub(FakeFarm):
    """A fake farm that plays click-test under the name of a task file."""

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        assert all(spec.task == SITE.task for spec in episodes.values())
        opened = super().reset({tab: replace(spec, task="click-test") for tab, spec in episodes.items()})
        return {tab: replace(seen, episode=episodes[tab]) for tab, seen in opened.items()}

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        assert all(command.following in (None, SITE) for command in commands.values())
        follows = {tab: c.following for tab, c in commands.items() if c.following is not None}
        results = super().step({tab: replace(c, following=None) for tab, c in commands.items()})
        opened = self.reset({tab: spec for tab, spec in follows.items() if results[tab].observation is None})
        return {tab: replace(r, observation=opened.get(tab, r.observation)) for tab, r in results.items()}


def test_each_episode_is_played_by_the_farm_of_its_task_and_tabs_change_between_them() -> None:
    farm = MixedFarm(FakeFarm(tabs=2), SiteStub(tabs=2))
    seen = farm.reset({0: MINIWOB, 1: SITE})
    assert [seen[tab].episode for tab in (0, 1)] == [MINIWOB, SITE]
    for first, second in ((SITE, MINIWOB), (SITE, SITE), (MINIWOB, SITE)):
        following = {0: first, 1: second}
        results = farm.step({tab: Command(verb=Verb.CLICK, ref=0, following=following[tab]) for tab in (0, 1)})
        assert all(result.done and result.raw_reward == 1.0 for result in results.values())
        observed = {tab: result.observation for tab, result in results.items()}
        assert {tab: one.episode for tab, one in observed.items() if one is not None} == following


def test_an_episode_that_goes_on_keeps_its_tab() -> None:
    farm = MixedFarm(FakeFarm(tabs=1), SiteStub(tabs=1))
    farm.reset({0: MINIWOB})
    result = farm.step({0: Command(verb=Verb.WAIT, ref=-1, following=SITE)})[0]
    assert result.observation is not None
    assert result.observation.episode == MINIWOB


class Closing(SiteStub):
    """A farm of task files whose pages in the tabs `closed` do not open."""

    closed: frozenset[int] = frozenset()

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        self.unopened = {tab: f"the page of tab {tab} is closed" for tab in episodes if tab in self.closed}
        return super().reset({tab: spec for tab, spec in episodes.items() if tab not in self.closed})


def test_the_reason_why_a_page_did_not_open_holds_for_its_call_and_no_longer() -> None:
    sites = Closing(tabs=2)
    farm = MixedFarm(FakeFarm(tabs=2), sites)
    farm.reset({0: MINIWOB, 1: SITE})
    sites.closed = frozenset({1})
    # In one call the next page of tab 1 does not open, and then tab 0 comes to the same farm.
    farm.step({tab: Command(verb=Verb.CLICK, ref=0, following=SITE) for tab in (0, 1)})
    assert farm.unopened == {1: "the page of tab 1 is closed"}
    farm.reset({0: MINIWOB})
    assert farm.unopened == {}


def test_miniwob_tasks_are_checked_by_name_and_have_their_experts() -> None:
    check_task("click-button")
    assert callable(expert_of("click-button"))
