"""Recording a person in Chrome. The tests send trusted input events instead of a person's."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import pytest

from browser_farm.chrome.devtools import BrowserGone
from browser_farm.human.recorder import Recorder
from browser_farm.human.steps import Interrupted
from giirl.run.record import record, watch
from giirl_core.gestures import BASIC
from giirl_core.progress import Display
from giirl_core.types import Action, Episode, EpisodeSpec, Outcome, Verb
from giirl_core.wire.messages import read_episodes, write_episodes
from tests.browser_farm.hand import Hand
from tests.learner.samples import FLAT, trajectory

SEED = 1
Play = Callable[[Hand, str], None]  # acts on a page with the given instruction


@pytest.fixture(scope="module")
def recorder() -> Iterator[Recorder]:
    with closing(Recorder(headless=True)) as recorder:
        yield recorder


def recorded(recorder: Recorder, task: str, play: Play, seed: int = SEED) -> Episode:
    hand = Hand(recorder)
    episode = recorder.record(EpisodeSpec(task=task, seed=seed), lambda goal: play(hand, goal))
    assert episode is not None
    assert episode.outcome.ended
    return episode


def actions_of(episode: Episode) -> list[tuple[str, str, str]]:
    """(verb, text or tag of the element, typed text) of every action."""
    trajectory = episode.trajectory
    lines = []
    for page, action in zip(trajectory.pages, trajectory.actions, strict=True):
        name = page.text[action.element] or page.tag[action.element] if action.element >= 0 else ""
        lines.append((action.verb.name, name, action.text(trajectory.goal)))
    return lines


@pytest.mark.chrome
def test_a_click_is_a_click_on_the_leaf_with_the_page_before_it(recorder: Recorder) -> None:
    episode = recorded(recorder, "click-button", lambda hand, goal: hand.click("button", goal.split('"')[1]))
    assert actions_of(episode) == [("CLICK", "Ok", "")]
    assert episode.outcome.success
    assert not episode.trajectory.pages[0].tampered.any()


@pytest.mark.chrome
def test_typing_is_one_action_with_a_span_of_the_instruction(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        hand.click("#tt")
        hand.type("Jeralx")
        hand.press("Backspace")
        hand.type("d")
        hand.click("button")

    episode = recorded(recorder, "enter-text", play)
    assert actions_of(episode) == [("TYPE", "input_text", "Jerald"), ("CLICK", "Submit", "")]
    assert episode.trajectory.actions[0].start >= 0
    assert episode.outcome.success
    episode.trajectory.choices(BASIC)


@pytest.mark.chrome
def test_tab_is_ignored_and_enter_on_a_button_is_a_click(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        _, name, _, password, _ = goal.split('"')
        hand.click("#username")
        hand.type(name)
        hand.press("Tab")
        hand.type(password)
        hand.press("Tab")
        hand.press("Enter")

    episode = recorded(recorder, "login-user", play)
    assert actions_of(episode) == [
        ("TYPE", "input_text", "vina"),
        ("TYPE", "input_password", "US"),
        ("CLICK", "Login", ""),
    ]
    assert episode.outcome.success


@pytest.mark.chrome
def test_a_click_on_a_label_is_a_click_on_its_checkbox(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        x, y = hand.find("label", "DKkQH")
        hand.click_at(x + 20, y)
        hand.click("button")

    episode = recorded(recorder, "click-checkboxes", play)
    assert actions_of(episode) == [("CLICK", "input_checkbox", ""), ("CLICK", "Submit", "")]
    assert episode.outcome.success


@pytest.mark.chrome
def test_a_choice_in_a_native_list_is_a_click_on_the_option(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        hand.ask("document.querySelector('select').focus();'ok'")
        for _ in range(5):
            hand.press("ArrowDown")
        hand.click("button")

    episode = recorded(recorder, "choose-list", play)
    assert actions_of(episode)[-2:] == [("CLICK", "Bobine", ""), ("CLICK", "Submit", "")]
    assert {verb for verb, _, _ in actions_of(episode)} == {"CLICK"}
    assert episode.outcome.success


@pytest.mark.chrome
def test_a_drag_has_its_start_and_distance(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        hand.drag(hand.find("circle"), (-30.0, 0.0))
        hand.click("button")

    episode = recorded(recorder, "drag-circle", play)
    first = episode.trajectory.actions[0]
    assert actions_of(episode) == [("DRAG", "circle", ""), ("CLICK", "Submit", "")]
    assert first.by == (-30.0, 0.0)
    assert max(map(abs, first.at)) < 1
    assert episode.outcome.success


@pytest.mark.chrome
def test_selecting_text_with_the_mouse_is_not_a_drag(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        hand.click("#tt")
        hand.type("wrong")
        x, y = hand.find("#tt")
        hand.drag((x + 50, y), (-110.0, 0.0))
        hand.type("Jerald")
        hand.click("button")

    episode = recorded(recorder, "enter-text", play)
    assert [verb for verb, _, _ in actions_of(episode)] == ["TYPE", "TYPE", "CLICK"]
    assert actions_of(episode)[1] == ("TYPE", "input_text", "Jerald")
    assert episode.outcome.success


@pytest.mark.chrome
def test_several_wheel_events_are_one_scroll_action(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        for _ in range(8):
            hand.wheel(hand.find("textarea"), -120.0)
        hand.click("button")

    episode = recorded(recorder, "scroll-text-2", play)
    assert actions_of(episode) == [("SCROLL", "textarea", ""), ("CLICK", "Submit", "")]
    assert episode.trajectory.actions[0].by == (0.0, -960.0)


@pytest.mark.chrome
def test_typing_into_the_parts_of_a_date_field_is_one_action(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        x, y = hand.find("input")
        hand.click_at(x - 50, y)
        hand.type(goal.split()[1].replace("/", ""))
        hand.click("button")

    episode = recorded(recorder, "enter-date", play)
    date = episode.trajectory.goal.utterance.split()[1]
    assert actions_of(episode) == [("TYPE", "input_date", date), ("CLICK", "Submit", "")]
    assert episode.outcome.success
    episode.trajectory.choices(BASIC)


@pytest.mark.chrome
def test_a_click_without_effect_is_ignored_and_a_failure_is_kept(recorder: Recorder) -> None:
    def play(hand: Hand, goal: str) -> None:
        hand.click("#query")
        hand.click_at(150, 190)
        hand.click("button", "TWO" if "ONE" in goal else "ONE")

    episode = recorded(recorder, "click-test-2", play)
    assert len(episode.trajectory) == 1
    assert episode.outcome.raw_reward == -1.0
    assert not episode.outcome.success


@pytest.mark.chrome
def test_leaving_the_page_interrupts_only_that_episode(recorder: Recorder) -> None:
    def leave(hand: Hand, goal: str) -> None:
        hand.ask("location.href = 'about:blank';'ok'")

    with pytest.raises(Interrupted):
        recorded(recorder, "click-test", leave)
    assert recorded(recorder, "click-test", lambda hand, goal: hand.click("button")).outcome.success


@pytest.mark.chrome
def test_closing_the_tab_ends_the_recording() -> None:
    with closing(Recorder(headless=True)) as recorder, pytest.raises(BrowserGone, match="the tab was closed"):
        recorded(recorder, "click-test", lambda hand, goal: hand.close())


@pytest.mark.chrome
def test_a_recorded_episode_survives_writing_and_reading(recorder: Recorder, tmp_path: Any) -> None:
    episode = recorded(recorder, "click-button", lambda hand, goal: hand.click("button", goal.split('"')[1]))
    write_episodes(tmp_path / "mine", [episode])
    (read,) = read_episodes(tmp_path / "mine")
    assert read.trajectory.actions == (Action(verb=Verb.CLICK, element=episode.trajectory.actions[0].element),)


class ScriptedRecorder:
    """A recorder whose episodes return or raise the given values in turn."""

    def __init__(self, *results: Episode | BaseException | None) -> None:
        self._results = iter(results)

    def record(
        self, spec: EpisodeSpec, show_instruction: Callable[[str], None], progress: str = "", note: str = ""
    ) -> Episode | None:
        result = next(self._results)
        if isinstance(result, BaseException):
            raise result
        return result


def episode_that_failed() -> Episode:
    click = Action(verb=Verb.CLICK, element=0)
    return Episode(
        trajectory=trajectory("Click Ok.", [FLAT], [click]),
        outcome=Outcome(raw_reward=-1.0, ended=True),
    )


@pytest.mark.parametrize("end", [KeyboardInterrupt(), BrowserGone("closed")])
def test_finished_episodes_are_kept_however_the_recording_ends(end: BaseException) -> None:
    finished = episode_that_failed()
    pages = [EpisodeSpec(task="click-test", seed=seed) for seed in range(5)]
    scripted = ScriptedRecorder(finished, None, Interrupted("page_hung"), end)
    assert list(watch(scripted, pages, 0, 5, Display())) == [finished]


def test_pages_are_shown_until_enough_are_recorded_and_discarded_ones_do_not_count() -> None:
    finished = episode_that_failed()
    pages = [EpisodeSpec(task="click-test", seed=seed) for seed in range(9)]
    scripted = ScriptedRecorder(finished, None, finished, finished)
    assert list(watch(scripted, pages, 1, 3, Display())) == [finished, finished]
    assert list(watch(scripted, pages, 3, 3, Display())) == []


def test_many_broken_episodes_in_a_row_are_one_error() -> None:
    pages = [EpisodeSpec(task="click-test", seed=seed) for seed in range(9)]
    lost = [Interrupted("page_hung")] * 9
    with pytest.raises(RuntimeError, match="click-test: 5 episodes in a row were lost, the last one: page_hung"):
        list(watch(ScriptedRecorder(*lost), pages, 0, 3, Display()))


def test_without_a_display_recording_is_a_value_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ValueError, match="there is no screen: DISPLAY is not set"):
        record(["click-test"], 1, 0, Display())
    with pytest.raises(ValueError, match="there is no MiniWoB task 'click-tset'"):
        record(["click-tset"], 1, 0, Display())
