"""Every task opens, takes every action, and shows the same page for the same seed, whatever was played before."""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.resources import files

import numpy as np
import pytest

from browser_farm.farm import ChromeFarm
from browser_farm.tasks import STATEFUL_TASKS, tasks
from giirl_core.types import Action, Command, EpisodeSpec, Observation, StepResult, Verb
from tests.browser_farm.real_farm import content

TABS = 8
MAX_ROUNDS = 60  # of random play, until each stateful page has kept some state


def registered() -> set[str]:
    """The names under which the miniwob package registers its environments."""
    source = (files("miniwob") / "registration.py").read_text()
    return set(re.findall(r'id="miniwob/(.+)-v1"', source))


def test_every_registered_task_is_found_by_name_and_by_family() -> None:
    assert len(registered()) == 128
    assert registered() <= set(tasks())
    assert tasks("email-inbox")[:2] == ("email-inbox", "email-inbox-delete")
    assert tasks("flight") == ("flight.AA", "flight.Alaska", "flight.Alaska-auto", "flight.Alaska-auto-medium")
    with pytest.raises(ValueError, match="no MiniWoB task 'flite'"):
        tasks("flite")


def random_action(observation: Observation, rng: np.random.Generator) -> Action:
    """A random verb on a random row."""
    row = int(rng.integers(len(observation.page)))
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


def play_randomly(chrome: ChromeFarm, names: list[str], rng: np.random.Generator) -> None:
    """Play random actions, past the ends of some episodes."""
    observations = chrome.reset({tab: EpisodeSpec(task=name, seed=100 + tab) for tab, name in enumerate(names)})
    for step in range(8):
        commands = {}
        for tab, observation in observations.items():
            following = EpisodeSpec(task=names[tab], seed=int(rng.integers(1 << 20)))
            action = random_action(observation, rng)
            commands[tab] = Command.of(action, observation, last=step % 4 == 3, following=following)
        for tab, result in chrome.step(commands).items():
            assert (result.lost, names[tab]) == ("", names[tab])
            assert result.observation is not None
            observations[tab] = result.observation


@pytest.mark.chrome
@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, len(tasks()), TABS))
def test_the_same_seed_gives_the_same_page_in_every_tab_and_after_any_history(chrome: ChromeFarm, first: int) -> None:
    names = list(tasks()[first : first + TABS])
    episodes = {tab: EpisodeSpec(task=name, seed=7) for tab, name in enumerate(names)}
    chrome.reset({tab: EpisodeSpec(task="click-test", seed=0) for tab in episodes})  # so that each loads a new document
    fresh = {names[tab]: content(observation) for tab, observation in chrome.reset(episodes).items()}
    play_randomly(chrome, names, np.random.default_rng(first))
    assert {names[tab]: content(observation) for tab, observation in chrome.reset(episodes).items()} == fresh
    rotated = names[1:] + names[:1]
    other_tabs = {tab: EpisodeSpec(task=name, seed=7) for tab, name in enumerate(rotated)}
    assert {rotated[tab]: content(observation) for tab, observation in chrome.reset(other_tabs).items()} == fresh


def content_of_episodes(chrome: ChromeFarm, episodes: dict[int, EpisodeSpec]) -> dict[int, list[object]]:
    """The first page of each episode, and the page after typing where suggestions have ids that count up."""
    observations = chrome.reset(episodes)
    found: dict[int, list[object]] = {tab: [content(observation)] for tab, observation in observations.items()}
    commands = {}
    for tab, episode in episodes.items():
        if episode.task.startswith("use-autocomplete"):
            field = Action(verb=Verb.TYPE, element=observations[tab].page.tag.index("input_text"), literal="A")
            commands[tab] = Command.of(field, observations[tab])
    for tab, result in chrome.step(commands).items() if commands else ():
        assert result.observation is not None
        found[tab].append(content(result.observation))
    return found


@pytest.mark.chrome
@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [sorted(STATEFUL_TASKS)[first : first + TABS] for first in range(0, len(STATEFUL_TASKS), TABS)]
)
def test_stateful_pages_keep_state_when_they_are_not_reloaded(
    chrome: ChromeFarm, names: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    episodes = {tab: EpisodeSpec(task=name, seed=7) for tab, name in enumerate(names)}
    chrome.reset({tab: EpisodeSpec(task="click-test", seed=0) for tab in episodes})
    fresh = content_of_episodes(chrome, episodes)
    monkeypatch.setattr("browser_farm.farm.needs_fresh_document", lambda task: False)
    stateful: set[str] = set()
    for number in range(MAX_ROUNDS):
        play_randomly(chrome, names, np.random.default_rng(number))
        played = content_of_episodes(chrome, episodes)
        stateful |= {names[tab] for tab in episodes if played[tab] != fresh[tab]}
        if len(stateful) == len(names):
            break
    assert stateful == set(names)


@pytest.mark.chrome
@pytest.mark.parametrize("task", ["email-inbox", "social-media-all", "text-editor", "click-menu-2"])
def test_tabs_that_share_a_process_and_its_images_show_the_same_page(chrome: ChromeFarm, task: str) -> None:
    chrome.reset({tab: EpisodeSpec(task="click-test", seed=0) for tab in range(TABS)})
    observations = chrome.reset({tab: EpisodeSpec(task=task, seed=1) for tab in range(TABS)})
    assert len({content(observation) for observation in observations.values()}) == 1
    assert task != "email-inbox" or "star" in observations[0].page.classes


@pytest.mark.chrome
def test_virtual_time_passes_in_steps_only(chrome: ChromeFarm) -> None:
    """The position of a moving shape depends on the number of steps, not on the time they took."""
    tracks = []
    for _ in range(2):
        page = chrome.reset({0: EpisodeSpec(task="chase-circle", seed=3)})[0].page
        track = [page.box[page.tag.index("circle")].tolist()]
        for _ in range(4):
            result: StepResult = chrome.step({0: Command(verb=Verb.WAIT)})[0]
            assert result.observation is not None
            page = result.observation.page
            track.append(page.box[page.tag.index("circle")].tolist())
        tracks.append(track)
    assert tracks[0] == tracks[1]
    assert len({tuple(box) for box in tracks[0]}) == 5
