"""A person shows the right way on a page of their own, and the stage keeps it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from browser_farm.human.site_recorder import SiteRecorder
from giirl.feedback.stage import Stage
from giirl_core.types import Episode, EpisodeSpec
from tests.browser_farm.human.person import Person, record
from tests.browser_farm.sites.guests import PAGE, TASK
from tests.giirl.feedback.examples import clicking

WAIT_S = 60.0


class SiteShower:
    """A SiteRecorder in whose windows a person adds the guest of the instruction."""

    def __init__(self, task: str) -> None:
        self._recorder = SiteRecorder([task], headless=True)

    def record(self, spec: EpisodeSpec, show_instruction: Callable[[str], None]) -> Episode | None:
        def add(person: Person) -> None:
            person.click("input")
            person.type(person.bar().split('"')[1])
            person.click("button", "Add")
            person.read("The page has ended the episode")
            person.choose("Keep")

        return record(self._recorder, spec, add)

    def close(self) -> None:
        self._recorder.close()


@pytest.mark.chrome
def test_what_a_person_shows_on_a_page_of_their_own_is_kept(tmp_path: Path) -> None:
    (tmp_path / "guests.html").write_text(PAGE)
    (tmp_path / "guests.toml").write_text(TASK.replace("expert =", "# "))
    one = clicking(1)
    one = replace(one, view=replace(one.view, task=str(tmp_path / "guests.toml")))
    stage = Stage(SiteShower, lambda task: None)
    stage.start(one, 0, "")
    deadline_s = time.monotonic() + WAIT_S
    while (take := stage.take_of(one.key)) is None or take.under_way:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    stage.close()
    assert take.shown is not None, take.error
    goal = take.shown.goal
    assert [(action.verb.name, action.text(goal)) for action in take.shown.actions] == [
        ("TYPE", goal.utterance.split('"')[1]),
        ("CLICK", ""),
    ]
