"""A farm with a real Chrome: its observations, and its recovery from failures."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import psutil
import pytest

from browser_farm.tasks import STATEFUL_TASKS
from giirl_core.types import Command, EpisodeSpec, StepResult, Verb
from tests.browser_farm.real_farm import Farm, click, content

pytestmark = pytest.mark.chrome


def play_scripted_steps(farm: Farm, task: str, steps: int) -> None:
    observations = farm.open(task, 500, 501, 502)
    for step in range(steps):
        commands = {}
        for tab, observation in observations.items():
            row = (7 * step + 3 * tab) % len(observation.page)
            verb = Verb.TYPE if observation.page.typable[row] else Verb.CLICK
            following = EpisodeSpec(task=task, seed=600 + 3 * step + tab)
            ref = int(observation.page.ref[row])
            commands[tab] = Command(verb=verb, ref=ref, text="Ada", last=step % 5 == 4, following=following)
        for tab, result in farm.chrome.step(commands).items():
            assert result.observation is not None
            observations[tab] = result.observation


@pytest.mark.parametrize(
    "task",
    ["click-test-2", "click-button", "enter-text", "email-inbox", "choose-list", "enter-date", "use-slider"],
)
def test_the_same_seed_gives_the_same_page_whatever_the_tab_showed_before(farm: Farm, task: str) -> None:
    farm.open("click-test", 1)
    fresh = content(farm.open(task, 42)[0])
    play_scripted_steps(farm, task, 12)
    assert [content(observation) for observation in farm.open(task, 42, 42, 42).values()] == [fresh] * 3
    assert content(farm.open(task, 43)[0]) != fresh or task in STATEFUL_TASKS
    assert farm.causes == []


def test_a_following_episode_shows_the_same_page_as_a_reset(farm: Farm) -> None:
    expected = {task: content(farm.open(task, 77)[0]) for task in ("click-button", "enter-text")}
    for task, page in expected.items():
        observation = farm.open("click-button", 5)[0]
        command = Command(verb=Verb.CLICK, ref=0, last=True, following=EpisodeSpec(task=task, seed=77))
        result = farm.chrome.step({0: command})[0]
        assert (content(result.observation), result.done, result.raw_reward) == (page, False, 0.0)
        assert observation.episode.seed == 5


def test_typing_replaces_the_value_of_a_field_and_marks_it_as_tampered(farm: Farm) -> None:
    observation = farm.open("enter-text", 3)[0]
    field = observation.page.tag.index("input_text")
    for text in ('two "words"', "Zoë\u2028", ""):
        ref = int(observation.page.ref[field])
        following = EpisodeSpec(task="enter-text", seed=4)
        result = farm.chrome.step({0: Command(verb=Verb.TYPE, ref=ref, text=text, following=following)})[0]
        assert result.observation is not None
        page = result.observation.page
        assert (page.value[field], bool(page.focused[field]), bool(page.tampered[field])) == (
            text,
            True,
            True,
        )
        assert page.tampered.sum() == 1


def test_options_of_a_closed_list_can_be_clicked(farm: Farm) -> None:
    observation = farm.open("choose-list", 3)[0]
    wanted = observation.goal.utterance.removeprefix("Select ").split(" from the list")[0]
    result = farm.chrome.step({0: click(observation, observation.page.text.index(wanted))})[0]
    assert result.observation is not None
    result = farm.chrome.step({0: click(result.observation, observation.page.text.index("Submit"))})[0]
    assert (result.done, result.raw_reward) == (True, 1.0)


def test_a_ref_that_is_not_on_the_page_does_nothing(farm: Farm) -> None:
    before = farm.open("click-test-2", 3)[0]
    for ref in (-5, 12345):
        command = Command(verb=Verb.CLICK, ref=ref, following=EpisodeSpec(task="click-test-2", seed=4))
        result = farm.chrome.step({0: command})[0]
        assert (result.done, result.lost, content(result.observation)) == (False, "", content(before))


def test_a_step_without_a_following_episode_returns_no_observation(farm: Farm) -> None:
    observation = farm.open("click-test", 3)[0]
    assert farm.chrome.step({0: click(observation, 1, seed=None)})[0] == StepResult(
        raw_reward=1.0, done=True, observation=None
    )
    with pytest.raises(ValueError, match="tab 0 has no episode"):
        farm.chrome.step({0: click(observation, 1)})


def test_an_endless_loop_loses_only_its_own_episode_and_its_tab_continues(farm: Farm) -> None:
    observations = farm.open("click-test-2", 3, 4, 5)
    farm.on_click(1, "while (true);")
    results = farm.chrome.step({tab: click(observation, 1) for tab, observation in observations.items()})
    assert [(result.done, result.lost) for result in results.values()] == [
        (True, ""),
        (False, "page_hung"),
        (True, ""),
    ]
    assert len({content(result.observation) for result in results.values()}) == 1
    assert farm.causes == ["page_hung"]


@pytest.mark.parametrize("dialog", ["alert('hello')", "confirm('sure?')", "prompt('who?')"])
def test_a_dialog_is_accepted_and_the_episode_continues(farm: Farm, dialog: str) -> None:
    observation = farm.open("click-test-2", 3)[0]
    farm.on_click(0, dialog)
    result = farm.chrome.step({0: click(observation, 1)})[0]
    assert (result.raw_reward, result.done, result.lost, farm.causes) == (1.0, True, "", [])


def test_an_episode_whose_page_navigated_away_is_lost_at_the_next_step(farm: Farm) -> None:
    observation = farm.open("click-test-2", 3)[0]
    assert farm.chrome._tabs.navigate({0: "about:blank"}) == {}  # a script would navigate only after the step
    result = farm.chrome.step({0: click(observation, 0)})[0]
    assert (result.lost, result.done, farm.causes) == ("navigated", False, ["navigated"])
    assert content(result.observation) == content(farm.open("click-test-2", 900)[0])


def test_a_crash_affects_only_the_tabs_of_its_process_and_all_recover(farm: Farm) -> None:
    observations = farm.open("click-test-2", 3, 4, 5)
    tabs = farm.chrome._tabs
    same_process = sorted(tabs._hub(0).tabs)
    tabs._tools.post(tabs._tab(0).session, "Page.crash")
    results = farm.chrome.step({0: click(observations[0], 1)})
    results |= farm.chrome.step({tab: click(observations[tab], 1) for tab in (1, 2)})
    assert {tab: result.lost for tab, result in results.items()} == {
        tab: "tab_crashed" if tab in same_process else "" for tab in (0, 1, 2)
    }
    assert (same_process, farm.causes) == ([0, 2], ["tab_crashed"] * 2)
    again = {tab: result.observation for tab, result in results.items() if result.observation is not None}
    done = farm.chrome.step({tab: click(observation, 1) for tab, observation in again.items()})
    assert [result.raw_reward for result in done.values()] == [1.0] * 3


def test_an_endless_loop_does_not_affect_the_other_tabs_of_its_process(farm: Farm) -> None:
    observations = farm.open("click-test-2", 3, 4, 5)
    farm.on_click(0, "while (true);")
    results = farm.chrome.step({tab: click(observation, 1) for tab, observation in observations.items()})
    assert {tab: (result.done, result.lost) for tab, result in results.items()} == {
        0: (False, "page_hung"),
        1: (True, ""),
        2: (True, ""),
    }


def test_a_page_has_no_network_access_even_to_localhost(farm: Farm) -> None:
    listener = subprocess.Popen(
        [sys.executable, "-m", "http.server", "0", "--bind", "127.0.0.1"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        assert listener.stdout is not None
        port = listener.stdout.readline().split(b" port ")[1].split()[0].decode()
        farm.open("click-test", 3)
        address = f"http://127.0.0.1:{port}/"
        fetch = f"fetch('{address}', {{mode: 'no-cors'}}).then(() => 'reached', () => 'refused')"
        answers = farm.chrome._tabs.evaluate({0: fetch}, await_promise=True)
        assert answers == {0: "refused"}
    finally:
        listener.kill()
        listener.communicate()


@pytest.mark.parametrize("victim", ["chrome", "chromedriver"])
def test_a_killed_browser_is_relaunched_with_all_its_tabs(farm: Farm, victim: str) -> None:
    observations = farm.open("click-test-2", 3, 4, 5)
    before = farm.pids()
    victims = [pid for pid in before if psutil.Process(pid).name().startswith("chromedriver") == (victim != "chrome")]
    for pid in victims:
        os.kill(pid, signal.SIGKILL)
    first = farm.chrome.step({0: click(observations[0], 1)})
    rest = farm.chrome.step({tab: click(observations[tab], 1) for tab in (1, 2)})
    lost = [result.lost for result in (*first.values(), *rest.values())]
    if victim == "chrome":
        assert (lost, farm.causes) == (["browser_died"] * 3, ["browser_died"])
        assert not any(psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie" for pid in before)
    else:
        assert (lost, farm.causes) == ([""] * 3, [])
    assert len({content(result.observation) for result in (*first.values(), *rest.values())}) == 1


def test_a_browser_that_stops_answering_is_relaunched(farm: Farm) -> None:
    observations = farm.open("click-test-2", 3, 4, 5)
    for pid in farm.pids():
        os.kill(pid, signal.SIGSTOP)
    results = farm.chrome.step({tab: click(observation, 1) for tab, observation in observations.items()})
    assert [result.lost for result in results.values()] == ["browser_died"] * 3
    assert farm.causes == ["browser_died"]


def test_a_browser_that_dies_during_a_call_is_relaunched(farm: Farm) -> None:
    observations = farm.open("click-test-2", 3, 4, 5)
    for tab in observations:
        farm.on_click(tab, "while (true);")
    pids = farm.pids()

    def kill() -> None:
        for pid in pids:
            if psutil.pid_exists(pid):
                os.kill(pid, signal.SIGKILL)

    killer = threading.Timer(0.5, kill)
    killer.start()
    results = farm.chrome.step({tab: click(observation, 1) for tab, observation in observations.items()})
    killer.join()
    assert {result.lost for result in results.values()} <= {"browser_died", "tab_crashed"}
    assert all(result.observation is not None for result in results.values())
