"""The page over HTTP: what a person presses becomes an answer, and what is not allowed gets a message."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event

import pytest

from browser_farm.human.steps import Interrupted
from giirl.feedback import desk
from giirl.feedback.stage import Stage
from giirl_core.types import Episode, EpisodeSpec, Outcome
from giirl_core.wire.answers import RIGHT, Answer, read_answer
from tests.command import Command
from tests.giirl.feedback.examples import DEADLINE_S, clicking, fetch, serving, typing
from tests.giirl.small import run

ONE, TWO = clicking(1), clicking(2, steps=3)
HOSTILE = "<script>document.title='owned'</script><img src=x onerror=alert(1)> \"'&lt;"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "feedback"


def the_answer(folder: Path) -> Answer:
    (path,) = folder.iterdir()
    return read_answer(path)


def test_right_makes_a_demonstration_and_the_window_gets_the_next_episode(folder: Path) -> None:
    with serving(folder, ONE, TWO) as served:
        assert ONE.key in served.get().text
        reply = served.post("right", ONE.key)
        assert TWO.key in reply.text
        assert "Answers so far: 1" in reply.text
    assert the_answer(folder).wrong_from == RIGHT


@pytest.mark.parametrize(("step", "wrong_from"), [("2", 1), ("", 2), ("nonsense", 2)])
def test_wrong_marks_the_step_or_else_the_last_one(step: str, wrong_from: int, folder: Path) -> None:
    with serving(folder, TWO) as served:
        served.get()
        served.post("wrong", TWO.key, step=step)
    assert the_answer(folder).wrong_from == wrong_from


def test_another_instruction_relabels_the_episode(folder: Path) -> None:
    with serving(folder, ONE) as served:
        served.get()
        served.post("wrong", ONE.key, right_for="  Press Ok.  ")
    (demonstration,) = the_answer(folder).demonstrations
    assert demonstration.goal.utterance == "Press Ok."


def test_what_is_no_answer_says_why_and_keeps_what_was_entered(folder: Path) -> None:
    with serving(folder, typing()) as served:
        served.get()
        for fields, words in (
            ({"right_for": "Enter Bertram.", "step": "1"}, "wanted an instruction with these words"),
            ({"step": "9"}, "step 8 is marked as wrong, the episode has 2 steps"),
        ):
            reply = served.post("wrong", typing().key, **fields)
            assert reply.status == 422
            assert words in reply.text
        assert "Enter Bertram." in served.post("wrong", typing().key, right_for="Enter Bertram.").text
    assert not folder.exists()


def test_the_answer_before_can_be_changed(folder: Path) -> None:
    with serving(folder, ONE, TWO) as served:
        served.get()
        reply = served.post("right", ONE.key)
        assert f"episode={ONE.key}" in reply.text
        assert f'value="{ONE.key}"' in served.get(f"window=a&episode={ONE.key}").text
        served.post("wrong", ONE.key)
        assert served.desk.answers == 1
    assert the_answer(folder).wrong_from == 1


def test_two_windows_get_different_episodes(folder: Path) -> None:
    with serving(folder, ONE, TWO) as served:
        a, b = served.get("window=a"), served.get("window=b")
        assert ONE.key in a.text
        assert TWO.key in b.text
        assert ONE.key in served.get("window=a").text
        assert "The policy plays the next episodes" in served.get("window=c").text
        assert fetch(served.url).url != fetch(served.url).url  # each window gets a name of its own


def test_skip_writes_nothing(folder: Path) -> None:
    with serving(folder, ONE, TWO) as served:
        served.get()
        assert TWO.key in served.post("skip", ONE.key).text
    assert not folder.exists()


def test_an_answer_to_an_episode_of_an_earlier_server_leads_to_the_next_one(folder: Path) -> None:
    with serving(folder, TWO) as served:
        assert TWO.key in served.post("right", "click-button-99.answer").text
        assert TWO.key in served.get("window=a&episode=click-button-99.answer").text
    assert not folder.exists()


def test_nobody_without_the_token_sees_or_answers_anything(folder: Path) -> None:
    with serving(folder, ONE) as served:
        root = served.url.rsplit("/", 2)[0]
        for address in (f"{root}/", f"{root}/wrong/", f"{root}/x/keys.js", f"{root}/%ff/"):
            assert fetch(address).status == 404
        assert fetch(f"{root}/wrong/right", {"window": "a", "key": ONE.key}).status == 404
    assert not folder.exists()


@pytest.mark.parametrize("form", [{}, {"window": "a"}, {"key": ONE.key}, {"window": "a", "key": "x" * 100_000}])
def test_a_broken_request_is_a_4xx(form: dict[str, str], folder: Path) -> None:
    with serving(folder) as served:
        assert 400 <= fetch(f"{served.url}nothing", form).status < 500
        assert fetch(f"{served.url}right", form).status in (200, 400, 413)
    assert not folder.exists()


def test_hostile_text_is_escaped_wherever_it_is_shown(folder: Path) -> None:
    hostile = clicking(1, text=HOSTILE)
    with serving(folder, hostile, TWO) as served:
        page = served.get().text
        refused = served.post("wrong", hostile.key, right_for=HOSTILE, step="9").text
        window = fetch(f"{served.url}?window=%22%3E%3Cscript%3E").text
    for text in (page, refused, window):
        assert "<script>" not in text
        assert "<img src=x" not in text
    assert "&lt;script&gt;" in page
    assert "&lt;script&gt;" in refused


class Shown:
    """A window in which a person acts when `done` is set, in place of Chrome."""

    def __init__(self, episode: Episode | None = None, error: Exception | None = None) -> None:
        self.episode, self.error, self.done, self.closed = episode, error, Event(), Event()

    def record(self, spec: EpisodeSpec, show_instruction: Callable[[str], None]) -> Episode | None:
        assert (spec.task, spec.seed) == ("click-button", 2)
        assert self.done.wait(DEADLINE_S)
        if self.error is not None or self.closed.is_set():
            raise self.error or Interrupted("the window was closed")
        return self.episode

    def close(self) -> None:
        self.closed.set()
        self.done.set()


def any_task(task: str) -> None:
    """Every task can be shown."""


def shown_by_a_person(steps: int) -> Episode:
    return Episode(trajectory=clicking(2, steps=steps).trajectory, outcome=Outcome(raw_reward=0.0, ended=True))


def until(words: str, read: Callable[[], str]) -> str:
    """The page as soon as it contains `words`."""
    deadline_s = time.monotonic() + DEADLINE_S
    while words not in (text := read()):
        assert time.monotonic() < deadline_s, text
        time.sleep(0.01)
    return text


def test_the_way_that_a_person_shows_is_kept_when_they_say_so(folder: Path) -> None:
    window = Shown(shown_by_a_person(1))
    with serving(folder, TWO, stage=Stage(lambda task: window, any_task)) as served:
        served.get()
        assert "A Chrome window shows the page" in served.post("show", TWO.key, step="2", right_for="Press Ok.").text
        assert "finish it first" in served.post("show", TWO.key).text
        window.done.set()
        page = until("You showed this way", lambda: served.get().text)
        assert "click button “Ok”" in page
        assert not folder.exists()
        served.post("keep", TWO.key)
    answer = the_answer(folder)
    assert answer.wrong_from == 1
    assert [(len(one), one.goal.utterance) for one in answer.demonstrations] == [
        (3, "Press Ok."),
        (1, 'Click on the "Ok" button.'),
    ]


@pytest.mark.parametrize(
    ("window", "words"),
    [(Shown(None), "nothing was done"), (Shown(error=Interrupted("the page was left")), "the page was left")],
    ids=["nothing", "left"],
)
def test_a_way_that_was_not_shown_is_no_answer(window: Shown, words: str, folder: Path) -> None:
    with serving(folder, TWO, stage=Stage(lambda task: window, any_task)) as served:
        served.get()
        window.done.set()
        served.post("show", TWO.key)
        until(words, lambda: served.get().text)
        served.post("keep", TWO.key)
        assert f'value="{TWO.key}"' in served.post("drop", TWO.key).text
    assert not folder.exists()


def test_cancel_closes_the_window_and_asks_again(folder: Path) -> None:
    window = Shown(shown_by_a_person(1))
    with serving(folder, TWO, stage=Stage(lambda task: window, any_task)) as served:
        served.get()
        served.post("show", TWO.key)
        assert "Did the policy do this" in served.post("drop", TWO.key).text
        assert window.closed.is_set()
    assert not folder.exists()


def test_cancel_while_the_window_opens_closes_it_too(folder: Path) -> None:
    window, opening = Shown(shown_by_a_person(1)), Event()

    def open_slowly(task: str) -> Shown:
        assert opening.wait(DEADLINE_S)
        return window

    with serving(folder, TWO, stage=Stage(open_slowly, any_task)) as served:
        served.get()
        served.post("show", TWO.key)
        assert "Did the policy do this" in served.post("drop", TWO.key).text
        opening.set()
        assert window.closed.wait(DEADLINE_S)


def test_without_a_screen_nothing_can_be_shown(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with serving(folder, TWO) as served:
        served.get()
        reply = served.post("show", TWO.key)
    assert reply.status == 422
    assert "there is no screen" in reply.text


def test_an_answer_that_cannot_be_saved_says_so_and_is_asked_again(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(folder: Path, answer: Answer) -> Path:
        raise OSError(errno.ENOSPC, "No space left on device", str(folder))

    with serving(folder, ONE) as served:
        served.get()
        with monkeypatch.context() as patch:
            patch.setattr(desk, "write_answer", full)
            reply = served.post("right", ONE.key)
        assert reply.status == 500
        assert "No space left on device; free some space there" in reply.text
        served.post("right", ONE.key)
    assert the_answer(folder).wrong_from == RIGHT


def test_a_restart_loses_no_answer(folder: Path) -> None:
    with serving(folder, ONE, TWO) as served:
        served.get()
        served.post("right", ONE.key)
    with serving(folder, TWO) as served:
        assert "Answers so far: 1" in served.get().text
        served.post("wrong", TWO.key)
        assert served.desk.answers == 2


def test_bad_input_is_one_line(giirl: Command, tmp_path: Path, folder: Path) -> None:
    assert "is not a run" in giirl("feedback", tmp_path / "none").error
    path = tmp_path / "run"
    run(path, "iterations=1")
    with serving(folder) as served:
        port = served.url.split(":")[2].partition("/")[0]
        error = giirl("feedback", path, "--port", port).error
    assert "Address already in use" in error
    assert error.endswith("wanted a free port, or 0")
    for checkpoint in (path / "checkpoints").iterdir():
        checkpoint.rename(tmp_path / checkpoint.name) if checkpoint.is_dir() else checkpoint.unlink()
    assert "has no checkpoint yet" in giirl("feedback", path).error


def test_a_run_that_learns_from_no_demonstrations_is_refused(giirl: Command, tmp_path: Path) -> None:
    run(tmp_path / "run", "iterations=1", "algorithm=true_reward")
    assert "no demonstration and no answer changes it" in giirl("feedback", tmp_path / "run").error


def test_a_run_in_the_grid_has_no_pages(giirl: Command, tmp_path: Path) -> None:
    assert giirl("train", "world=gridcraft", "iterations=1", "runtime=serial", f"run={tmp_path / 'grid'}").status == 0
    assert "which has no pages" in giirl("feedback", tmp_path / "grid").error
