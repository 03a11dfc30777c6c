"""Records a person at a Chrome window: clicks, typing, drags and keys become the actions that policies use."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

from browser_farm import pages
from browser_farm.chrome.answers import Failure
from browser_farm.chrome.devtools import BrowserGone
from browser_farm.chrome.tabs import Tabs
from browser_farm.human.steps import POLL_S, Interrupted, Step, episode_of
from browser_farm.tasks import page_url
from giirl_core.config.sections import Sandbox
from giirl_core.types import Episode, EpisodeSpec, Goal, Outcome, Verb

TAB = 0
TAKE_STEPS = "window.giirlRecorder&&window.giirl&&giirl.isOpen()?giirlRecorder.take():'gone'"


class Recorder:
    """One Chrome with one window, in which `record` shows a page until the person has ended its episode.

    Timeouts are in seconds. `chrome_sandbox` is as in `browser_farm.farm.ChromeFarm`.
    """

    def __init__(
        self,
        *,
        headless: bool = False,
        call_timeout_s: float = 10.0,
        launch_timeout_s: float = 60.0,
        chrome_sandbox: Sandbox = "auto",
    ) -> None:
        self._tabs = Tabs(
            1,
            view=pages.View(reader="reading", decode=pages.decode_page, first=("person", "recorder")),
            call_timeout_s=call_timeout_s,
            launch_timeout_s=launch_timeout_s,
            headless=headless,
            sandbox=chrome_sandbox,
        )
        try:
            self._tabs.launch()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close Chrome."""
        self._tabs.close()

    def record(
        self, spec: EpisodeSpec, show_instruction: Callable[[str], None], progress: str = "", note: str = ""
    ) -> Episode | None:
        """Open a page, pass its instruction to `show_instruction`, and wait for the end of the episode.

        The page shows its instruction itself, and neither `progress` nor `note`. Returns None for an episode without an
        action. The person may take any time; only calls to the page have a deadline. Interrupted if the person left the
        page; BrowserGone if the tab or Chrome was closed.
        """
        goal = self._open(spec)
        show_instruction(goal.utterance)
        steps: list[list[Any]] = []
        while True:
            taken, done, raw_reward = json.loads(_checked(self._tabs.evaluate({TAB: TAKE_STEPS})[TAB]))
            steps += taken
            if done:
                outcome = Outcome(raw_reward=float(raw_reward), ended=True)
                return episode_of(spec, goal, [_step(row) for row in steps], outcome)
            time.sleep(POLL_S)

    def _open(self, spec: EpisodeSpec) -> Goal:
        for failure in self._tabs.navigate({TAB: page_url(spec.task)}).values():
            raise Interrupted(f"{spec.task} cannot be opened: {failure.cause} {failure.message}")
        self._tabs.show(TAB)
        goal = pages.decode(_checked(self._tabs.ask({TAB: pages.start_call(spec)}, opening=True)[TAB]), pages.ROWS).goal
        assert goal is not None, "an opened page reports its instruction"
        return goal


def _checked(answer: Any | Failure) -> Any:
    """The answer of a page. BrowserGone if its tab is gone, Interrupted for any other failure."""
    if isinstance(answer, Failure) and answer.cause == "tab_crashed":
        raise BrowserGone("the tab was closed or crashed")
    if isinstance(answer, Failure):
        raise Interrupted(f"{answer.cause} {answer.message}".strip())
    if answer == pages.GONE:
        raise Interrupted("the page was left")
    return answer


def _step(row: list[Any]) -> Step:
    """A step of recorder.js: page, verb, ref, text, x, y, dx, dy."""
    columns, verb, ref, text, x, y, dx, dy = row
    return Step(
        page=pages.decode_page(columns),
        verb=Verb(verb),
        ref=ref,
        text=text,
        at=(float(x), float(y)),
        by=(float(dx), float(dy)),
    )
