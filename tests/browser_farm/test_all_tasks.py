"""Every task there is opens, takes every action, and shows the same page for the same seed, whatever came before."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files

import numpy as np
import pytest

from browser_farm.farm import ChromeFarm
from browser_farm.tasks import STATEFUL_TASKS, tasks
from giirl_core.types import Action, Command, EpisodeSpec, Observation, StepResult, Verb
from tests.browser_farm.real_farm import seen

TABS = 8
ROUNDS = 60  # of random play, until each page has shown what it carries over


def registered() -> set[str]:
    """The names under which the miniwob package registers its environments."""
    source = (files("miniwob") / "registration.py").read_text()
    return set(re.findall(r'id="miniwob/(.+)-v1"', source))


def test_every_registered_task_is_reached_by_name_and_by_family() -> None:
    assert len(registered()) == 128
    assert registered() <= set(tasks())
    assert tasks("email-inbox")[:2] == ("email-inbox", "email-inbox-delete")
    assert tasks("flight") == ("flight.AA", "flight.Alaska", "flight.Alaska-auto", "flight.Alaska-auto-medium")
    with pytest.raises(ValueError, match="no MiniWoB task 'flite'"):
        tasks("flite")


def some_action(shown: Observation, rng: np.random.Generator) -> Action:
    """Any verb on any row."""
    row = int(rng.integers(len(shown.page)))
    by = (float(rng.integers(-60, 60)), float(rng.integers(-60, 60)))
    return (
        Action(verb=Verb.CLICK, element=row),
        Action(verb=Verb.TYPE, element=row, literal="Ada 7"),
        Action(verb=Verb.DRAG, element=row, by=by),
        Action(verb=Verb.HOVER, element=row),
        Action(verb=Verb.SCROLL, element=row, by=by),
        Action(verb=Verb.PRESS, literal=str(rng.choice(["Enter", "a", "ArrowDown", "Tab", "Control+a"]))),
        Action(verb=Verb.DOUBLE_CLICK, element=row),
    )[int(rng.integers(7))]


@pytest.fixture(scope="module")
def chrome() -> Iterator[ChromeFarm]:
    with ChromeFarm(tabs=TABS, call_timeout_s=20.0) as farm:
        yield farm


def disturb(chrome: ChromeFarm, names: list[str], rng: np.random.Generator) -> None:
    """Play anything, through ends of episodes and on to others."""
    shown = chrome.reset({tab: EpisodeSpec(task=name, seed=100 + tab) for tab, name in enumerate(names)})
    for step in range(8):
        commands = {}
        for tab, observation in shown.items():
            following = EpisodeSpec(task=names[tab], seed=int(rng.integers(1 << 20)))
            action = some_action(observation, rng)
            commands[tab] = Command.of(action, observation, last=step % 4 == 3, following=following)
        for tab, result in chrome.step(commands).items():
            assert (result.lost, names[tab]) == ("", names[tab])
            assert result.observation is not None
            shown[tab] = result.observation


@pytest.mark.chrome
@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, len(tasks()), TABS))
def test_same_seed_same_page_in_whatever_tab_and_after_whatever_history(chrome: ChromeFarm, first: int) -> None:
    names = list(tasks()[first : first + TABS])
    there = {tab: EpisodeSpec(task=name, seed=7) for tab, name in enumerate(names)}
    chrome.reset({tab: EpisodeSpec(task="click-test", seed=0) for tab in there})  # so that each is a new document
    fresh = {names[tab]: seen(observation) for tab, observation in chrome.reset(there).items()}
    disturb(chrome, names, np.random.default_rng(first))
    assert {names[tab]: seen(shown) for tab, shown in chrome.reset(there).items()} == fresh
    turned = names[1:] + names[:1]
    elsewhere = {tab: EpisodeSpec(task=name, seed=7) for tab, name in enumerate(turned)}
    assert {turned[tab]: seen(shown) for tab, shown in chrome.reset(elsewhere).items()} == fresh


@pytest.mark.chrome
@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [sorted(STATEFUL_TASKS)[first : first + TABS] for first in range(0, len(STATEFUL_TASKS), TABS)]
)
def test_pages_that_are_loaded_anew_would_carry_something_over_to_the_next_episode(
    chrome: ChromeFarm, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    there = {tab: EpisodeSpec(task=name, seed=7) for tab, name in enumerate(names)}
    chrome.reset({tab: EpisodeSpec(task="click-test", seed=0) for tab in there})
    fresh = {tab: seen(observation) for tab, observation in chrome.reset(there).items()}
    monkeypatch.setattr("browser_farm.farm.needs_fresh_document", lambda task: False)
    carried: set[str] = set()
    for number in range(ROUNDS):
        disturb(chrome, names, np.random.default_rng(number))
        carried |= {names[tab] for tab, observation in chrome.reset(there).items() if seen(observation) != fresh[tab]}
        if len(carried) == len(names):
            break
    assert carried == set(names)


@pytest.mark.chrome
@pytest.mark.parametrize("task", ["email-inbox", "social-media-all", "text-editor", "click-menu-2"])
def test_tabs_that_share_a_process_and_its_images_show_the_same_page(chrome: ChromeFarm, task: str) -> None:
    chrome.reset({tab: EpisodeSpec(task="click-test", seed=0) for tab in range(TABS)})
    shown = chrome.reset({tab: EpisodeSpec(task=task, seed=1) for tab in range(TABS)})
    assert len({seen(observation) for observation in shown.values()}) == 1
    assert task != "email-inbox" or "star" in shown[0].page.classes


@pytest.mark.chrome
def test_time_goes_on_with_every_step_and_never_between(chrome: ChromeFarm) -> None:
    """A shape that moves is where it is after so many steps, however long they took."""
    places = []
    for _ in range(2):
        shown = chrome.reset({0: EpisodeSpec(task="chase-circle", seed=3)})[0]
        track = [shown.page.box[shown.page.tag.index("circle")].tolist()]
        for _ in range(4):
            result: StepResult = chrome.step({0: Command(verb=Verb.WAIT)})[0]
            assert result.observation is not None
            page = result.observation.page
            track.append(page.box[page.tag.index("circle")].tolist())
        places.append(track)
    assert places[0] == places[1]
    assert len({tuple(place) for place in places[0]}) == 5
