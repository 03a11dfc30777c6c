"""Recording on own pages as a command: continued files, Ctrl-C, and training on what was recorded."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from browser_farm.human.site_recorder import SiteRecorder
from giirl_core.wire.messages import read_episodes
from tests.browser_farm.human.person import Person
from tests.command import Command

PAGE = """<!DOCTYPE html><label>Name <input id=name></label><button onclick="add()">Add</button><ul id=list></ul>
<script>
function add() { list.innerHTML = '<li></li>'; list.firstChild.textContent = document.getElementById('name').value; }
</script>"""
TASK = """address = "guests.html"
instructions = 'Add the guest "{name}".'
[fields]
name = ["Ada", "Grace", "Edsger", "Barbara", "Tony", "Radia", "Ken", "Hedy"]
[end]
selector = "#list li"
[success]
script = "document.querySelector('#list li').textContent === {name}"
"""
FEW = ["runtime=serial", "net.vectors=hashed", "net.width=8", "iterations=1", "rollout_batch=2", "step_limit=3"]


@pytest.fixture
def task(tmp_path: Path) -> str:
    (tmp_path / "guests.html").write_text(PAGE)
    (tmp_path / "guests.toml").write_text(TASK)
    return str(tmp_path / "guests.toml")


class Hands:
    """Opens recorders without a screen, each with a person who acts in a thread."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.act: Callable[[Person], None] = lambda person: None
        self.failures: list[BaseException] = []
        monkeypatch.setattr("giirl.run.record.check_screen", lambda: None)
        monkeypatch.setattr("giirl.run.record.open_recorder", self.open)

    def open(self, tasks: Sequence[str]) -> SiteRecorder:
        recorder = SiteRecorder(tasks, headless=True)
        threading.Thread(target=self._run, args=(recorder,), daemon=True).start()
        return recorder

    def _run(self, recorder: SiteRecorder) -> None:
        person = Person(recorder)
        try:
            self.act(person)
        except BaseException as error:  # noqa: BLE001 - the test raises it in its own thread
            self.failures.append(error)
            person.close_window(of_bar=True)
        finally:
            person.tools.close()


def add_guest(person: Person) -> None:
    person.look_at_page()
    person.read('"')
    person.click("#name")
    person.type(person.bar().split('"')[1])
    person.click("button")
    person.read("it succeeded")


@pytest.mark.chrome
@pytest.mark.slow
def test_a_recording_is_interrupted_continued_and_trained_on(
    giirl: Command, task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hands = Hands(monkeypatch)
    words = ("demos", "record", "--task", task, "--per-task", "3", "--out", "mine.giirl")

    def one_and_interrupt_during_the_second(person: Person) -> None:
        add_guest(person)
        person.choose("Keep")
        person.look_at_page()
        person.read("1 of 3 recorded")
        person.click("#name")
        person.type("half")
        os.kill(os.getpid(), signal.SIGINT)

    hands.act = one_and_interrupt_during_the_second
    answer = giirl(*words)
    assert hands.failures == []
    assert answer.status == 0, answer.err
    assert "stopped" in answer.err
    (first,) = read_episodes(tmp_path / "mine.giirl")

    def one_and_interrupt_when_the_page_has_ended_the_next(person: Person) -> None:
        add_guest(person)
        person.choose("Keep")
        add_guest(person)
        os.kill(os.getpid(), signal.SIGINT)

    hands.act = one_and_interrupt_when_the_page_has_ended_the_next
    assert giirl(*words).status == 0
    assert hands.failures == []
    episodes = read_episodes(tmp_path / "mine.giirl")
    assert episodes[0].trajectory.seed == first.trajectory.seed
    assert len({episode.trajectory.seed for episode in episodes}) == len(episodes) == 3
    assert all(episode.outcome.success and not episode.trajectory.unlearnable() for episode in episodes)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["guests.html", "guests.toml", "mine.giirl"]

    settings = [f'tasks=["{task}"]', "demos.source=file", "demos.path=mine.giirl", "run=run", "actors.tabs=1"]
    answer = giirl("train", *FEW, *settings, "evaluate.episodes=2", "evaluate.random_episodes=1")
    assert answer.status == 0, answer.err
    answer = giirl("play", "run", "--task", task, "--goal", 'Add the guest "Zoe".')
    assert answer.status == 0, answer.err
    assert "no verdict" in answer.out


@pytest.mark.chrome
@pytest.mark.slow
@pytest.mark.parametrize(
    ("address", "more", "message"),
    [
        ("http://127.0.0.1:4319/", "", "does not open: unreachable http://127.0.0.1:4319/ cannot be opened"),
        ("guests.html", '[login.expired]\nselector = "button"\n', "does not open: login_expired the login has expired"),
        ("guests.html", '[begin]\nselector = "#never"\n', "does not open: missing '#never' did not appear"),
    ],
)
def test_a_page_that_does_not_open_is_one_line_and_nothing_is_recorded(
    address: str, more: str, message: str, giirl: Command, task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Hands(monkeypatch)
    bad = tmp_path / "bad.toml"
    bad.write_text(f'address = "{address}"\ninstructions = "Do it."\n{more}[wait]\ndeadline_s = 1\n')
    answer = giirl("demos", "record", "--task", bad, "--out", "mine.giirl")
    assert message in answer.error
    assert not (tmp_path / "mine.giirl").exists()


def test_a_file_that_is_no_recording_is_not_replaced(giirl: Command, task: str, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("keep")
    assert "thesis.txt is not an episode file" in giirl("demos", "record", "--task", task, "--out", "thesis.txt").error
    assert (tmp_path / "thesis.txt").read_text() == "keep"


def test_a_wrong_task_file_is_one_line_before_a_window_opens(giirl: Command) -> None:
    answer = giirl("demos", "record", "--task", "nowhere.toml", "--out", "mine.giirl")
    assert "cannot read the task file nowhere.toml" in answer.error
