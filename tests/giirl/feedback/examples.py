"""Candidates and answers for the tests of giirl feedback, and a server with a desk but without a browser."""

from __future__ import annotations

import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Thread

from browser_farm.human.recorder import Recorder
from giirl.feedback.desk import Desk
from giirl.feedback.page import Pages
from giirl.feedback.selector import Candidate, candidate_of
from giirl.feedback.server import FeedbackServer
from giirl.feedback.stage import Stage
from giirl.report.element_rewards import EpisodeView, Frame
from giirl.run.record import check_recordable
from giirl_core.config_file import load_config
from giirl_core.types import Action, Goal, Outcome, Verb
from tests.giirl.report.examples import GOAL, page, scored

DEADLINE_S = 20.0
FORM = page(("input_text", "", (10, 60, 90, 20)), ("button", "Submit", (10, 90, 60, 20)))
ENTER = Goal('Enter "Ada" into the text field and press Submit.')


def clicking(seed: int, *, steps: int = 2, goal: Goal = GOAL, text: str = "Ok", rewards: float = 4.8) -> Candidate:
    """An episode that clicks the first of two buttons in every step."""
    buttons = page(("button", text, (10, 60, 40, 20)), ("button", "Cancel", (10, 90, 60, 20)))
    frame = Frame(page=buttons, screenshot=None, own=scored(rewards, -3.2, goal=goal), other=None)
    outcome = Outcome(raw_reward=1.0, ended=True)
    return candidate_of(EpisodeView(task="click-button", seed=seed, frames=(frame,) * steps, outcome=outcome))


def typing(seed: int = 1) -> Candidate:
    """An episode that types Ada and presses Submit."""
    start, end = ENTER.find("Ada")
    first = replace(scored(goal=ENTER), policy_action=Action(verb=Verb.TYPE, element=0, start=start, end=end))
    frames = (
        Frame(page=FORM, screenshot=None, own=first, other=None),
        Frame(page=FORM, screenshot=None, own=scored(goal=ENTER, chosen=1), other=None),
    )
    return candidate_of(
        EpisodeView(task="enter-text", seed=seed, frames=frames, outcome=Outcome(raw_reward=1.0, ended=True))
    )


@dataclass(frozen=True, slots=True)
class Reply:
    """Status, final address and text of a response, after redirects."""

    status: int
    url: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Served:
    """A server under test."""

    desk: Desk
    stage: Stage
    url: str

    def get(self, query: str = "window=a") -> Reply:
        return fetch(f"{self.url}?{query}")

    def post(self, verb: str, key: str, **fields: str) -> Reply:
        return fetch(f"{self.url}{verb}", {"window": "a", "key": key, **fields})


def fetch(url: str, form: dict[str, str] | None = None) -> Reply:
    """GET, or POST with a form; an error status is a reply too."""
    data = urllib.parse.urlencode(form).encode() if form is not None else None
    try:
        with urllib.request.urlopen(url, data, timeout=DEADLINE_S) as response:
            return Reply(response.status, response.url, response.read().decode())
    except urllib.error.HTTPError as error:
        with error:
            return Reply(error.code, error.url or "", error.read().decode())


@contextmanager
def serving(folder: Path, *candidates: Candidate, stage: Stage | None = None, port: int = 0) -> Iterator[Served]:
    """A server whose answers go to `folder`, in a thread of its own."""
    desk, stage = Desk(folder), stage or Stage(lambda task: Recorder(), lambda task: check_recordable([task]))
    desk.offer(candidates)
    server, stop, ready = FeedbackServer(desk, stage, Pages(load_config(None, []), "test"), port), Event(), Event()
    thread = Thread(target=server.serve, args=(stop, lambda address: ready.set()))
    thread.start()
    assert ready.wait(DEADLINE_S)
    try:
        yield Served(desk=desk, stage=stage, url=server.address)
    finally:
        stop.set()
        thread.join(DEADLINE_S)
        stage.close()
