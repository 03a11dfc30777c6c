"""Real Chrome behind the `Browser` protocol: steps many episodes at once, and recovers from every failure."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from browser_farm import pages
from browser_farm.chrome import trusted_input
from browser_farm.chrome.answers import Failure, decode, pixels
from browser_farm.chrome.devtools import BrowserGone
from browser_farm.chrome.tabs import Tabs
from browser_farm.tasks import needs_fresh_document, page_url
from giirl_core.config.sections import Sandbox
from giirl_core.types import Command, EpisodeSpec, Goal, Observation, StepResult, Verb

OPEN_ATTEMPTS = 4  # in the tab as it is, in a new document, in a new renderer process, in a new Chrome
T = TypeVar("T")


@dataclass(slots=True, kw_only=True)
class TabState:
    """What one tab shows."""

    task: str | None = None  # whose document is loaded; None makes the next episode load one
    episode: EpisodeSpec | None = None  # in progress
    goal: Goal | None = None  # of that episode
    lost: str = ""  # why the episode was lost, until the next step reports it


class ChromeFarm:
    """A `giirl_core.types.Browser` with `tabs` tabs in one Chrome of its own.

    A failure of a page or of Chrome costs the affected episodes (`StepResult.lost`), and `on_restart` is called with
    its cause: "page_hung", "tab_crashed", "navigated" or "page_error" once per tab, "browser_died" once per Chrome.
    Every call returns or raises within a few times `call_timeout_s` and `launch_timeout_s`.

    Raises ValueError for a wrong argument, and RuntimeError when Chrome cannot be started.
    """

    def __init__(
        self,
        *,
        tabs: int = 8,
        call_timeout_s: float = 10.0,
        launch_timeout_s: float = 60.0,
        headless: bool = True,
        chrome_sandbox: Sandbox = "auto",  # GIIRL_CHROME_SANDBOX, else "on", but "off" as root, where Chrome refuses it
        view: pages.View = pages.ROWS,
        base_url: str = "",  # folder of the pages, as file:// or http:// URL; "" for those of the miniwob package
        trusted: bool = False,  # act through Chrome's native mouse and keyboard input instead of DOM events
        on_restart: Callable[[str], None] = lambda cause: None,
    ) -> None:
        if tabs < 1:
            raise ValueError(f"ChromeFarm.tabs is {tabs}: wanted at least 1")
        for name, value in (("call_timeout_s", call_timeout_s), ("launch_timeout_s", launch_timeout_s)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"ChromeFarm.{name} is {value}: wanted a number of seconds above 0")
        self.tabs = tabs
        self.unopened: dict[int, str] = {}
        self._base_url = base_url
        self._view = replace(view, emulation=(*view.emulation, *trusted_input.EMULATION)) if trusted else view
        self._trusted = trusted
        self._on_restart = on_restart
        self._states = [TabState() for _ in range(tabs)]
        self._closed = False
        self._tabs = Tabs(
            tabs,
            view=self._view,
            call_timeout_s=call_timeout_s,
            launch_timeout_s=launch_timeout_s,
            headless=headless,
            sandbox=chrome_sandbox,
            base_url=base_url,
        )
        try:
            self._tabs.launch()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> ChromeFarm:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def chrome_directory(self) -> str:
        """The directory of this farm's Chrome, by which `reaper.processes` finds its processes."""
        return str(self._tabs.chrome.directory)

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        self._check_tabs(episodes)
        for episode in episodes.values():
            page_url(episode.task, self._base_url)
        self.unopened.clear()
        return self._open(dict(episodes))

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        self._check_tabs(commands)
        requests: dict[int, pages.Json] = {}
        for command in commands.values():
            if command.following is not None:
                page_url(command.following.task, self._base_url)
        self.unopened.clear()
        acted = self._send_trusted_input(commands) if self._trusted else set()
        for tab, command in commands.items():
            state = self._states[tab]
            if state.episode is None:
                raise ValueError(f"tab {tab} has no episode: call reset before step")
            if not state.lost:
                action = replace(command, verb=Verb.WAIT) if tab in acted else command
                requests[tab] = pages.step_call(action, state.episode.task)
        answers = self._ask(requests)
        results: dict[int, StepResult] = {}
        to_open: dict[int, EpisodeSpec] = {}
        for tab, command in commands.items():
            results[tab] = self._advance(tab, command, answers.get(tab))
            if results[tab].observation is None and command.following is not None:
                to_open[tab] = command.following
        for tab, observation in self._open(to_open).items():
            results[tab] = replace(results[tab], observation=observation)
        return results

    def screenshot(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes:
        """PNG of a part of a tab: left, top, width, height in CSS px, with `scale` pixels per CSS px.

        Returns b"" for a tab that does not answer; its episode is reported as lost by the next step.
        """
        return self._call(tab, lambda: self._tabs.screenshot(tab, box, scale)) or b""

    def run_script(self, tab: int, script: str) -> str | None:
        """Run a script in a tab's page; the string that it ends with, None for a tab that does not answer."""
        return self._call(tab, lambda: self._tabs.evaluate({tab: script})[tab])

    def refresh(self, tab: int) -> None:
        """Let the tab's next episode load its document anew."""
        self._states[tab].task = None

    def screenshots(self, tabs: Iterable[int], width: int, height: int) -> dict[int, NDArray[np.uint8]]:
        """[height, width, 3] RGB of each tab's upper left corner, taken one by one; black for a tab without picture."""
        return {tab: pixels(self.screenshot(tab, (0, 0, width, height)), width, height) for tab in tabs}

    def close(self) -> None:
        self._closed = True
        self._tabs.close()

    def _check_tabs(self, tabs: Iterable[int]) -> None:
        if self._closed:
            raise RuntimeError("this ChromeFarm is closed")
        for tab in tabs:
            if not 0 <= tab < self.tabs:
                raise ValueError(f"there is no tab {tab}: wanted 0 to {self.tabs - 1}")

    def _call(self, tab: int, call: Callable[[], T | Failure]) -> T | None:
        """The result of a call to one tab; None if there is none, and its episode is lost."""
        self._check_tabs({tab: None})
        if self._states[tab].lost:
            return None
        try:
            outcome = call()
        except BrowserGone:
            self._relaunch()
            return None
        if isinstance(outcome, Failure):
            self._lose(tab, outcome)
            return None
        return outcome

    def _ask(self, requests: Mapping[int, pages.Json]) -> dict[int, pages.Answer]:
        """The answers of the pages. A tab without one is marked as lost and recovered."""
        answers: dict[int, pages.Answer] = {}
        if not requests:
            return answers
        try:
            for tab, outcome in self._tabs.ask(requests).items():
                answer = decode(outcome, self._view)
                if isinstance(answer, Failure):
                    self._lose(tab, answer)
                else:
                    answers[tab] = answer
        except BrowserGone:
            self._relaunch()
            return {}
        return answers

    def _send_trusted_input(self, commands: Mapping[int, Command]) -> set[int]:
        """Perform the actions that native input can perform; returns their tabs."""
        able = {tab: c for tab, c in commands.items() if self._states[tab].episode and not self._states[tab].lost}
        try:
            aims = self._tabs.ask({tab: pages.aim_call(command) for tab, command in able.items()})
            events = {tab: trusted_input.events(able[tab], aim) for tab, aim in aims.items() if isinstance(aim, list)}
            for tab, failure in self._tabs.send_input(events).items():
                self._lose(tab, failure)
            scrolled = [tab for tab in events if able[tab].verb is Verb.SCROLL and not self._states[tab].lost]
            if scrolled:
                self._tabs.evaluate(dict.fromkeys(scrolled, pages.SCROLL_DRAWN), await_promise=True)
        except BrowserGone:
            self._relaunch()
            return set()
        return set(events)

    def _advance(self, tab: int, command: Command, answer: pages.Answer | None) -> StepResult:
        """Update the tab's state. The result has no observation if the farm still has to open the next episode."""
        state = self._states[tab]
        if state.lost or answer is None:
            result = StepResult(raw_reward=0.0, done=False, observation=None, lost=state.lost)
            state.episode, state.goal, state.lost = None, None, ""
            return result
        if answer.done or command.last:
            state.episode, state.goal = (command.following if answer.page is not None else None), answer.goal
        observation = None
        if answer.page is not None and state.episode is not None and state.goal is not None:
            observation = Observation(episode=state.episode, page=answer.page, goal=state.goal)
        return StepResult(
            raw_reward=answer.raw_reward,
            done=answer.done,
            observation=observation,
            reason=answer.reason,
            scaled_reward=answer.scaled_reward,
        )

    def _open(self, episodes: dict[int, EpisodeSpec]) -> dict[int, Observation]:
        """Open an episode in each tab, recovering from failures. `unopened` says why one did not open."""
        opened: dict[int, Observation] = {}
        failures: dict[int, Failure] = {}  # the last of each tab
        for tab in episodes:
            self._states[tab].episode, self._states[tab].lost = None, ""
        for attempt in range(OPEN_ATTEMPTS):
            missing = {tab: episode for tab, episode in episodes.items() if tab not in opened}
            if not missing:
                break
            try:
                for tab, failure in self._try_open(missing, opened).items():
                    failures[tab] = failure
                    self._recover(tab, failure, attempt=attempt)
            except BrowserGone as error:
                failures |= dict.fromkeys(episodes, Failure(cause="browser_died", message=str(error)))
                self._relaunch()
                opened.clear()
                for tab in episodes:
                    self._states[tab].episode, self._states[tab].lost = None, ""
        for tab, episode in episodes.items():
            if tab not in opened:
                page = f"task {episode.task} with seed {episode.seed}"
                self.unopened[tab] = f"{page} does not open after {OPEN_ATTEMPTS} attempts: {failures[tab]}"
        return {tab: opened[tab] for tab in episodes if tab in opened}

    def _try_open(self, missing: Mapping[int, EpisodeSpec], opened: dict[int, Observation]) -> dict[int, Failure]:
        """Open each episode once. Adds observations to `opened` and returns the failures."""
        urls = {
            tab: page_url(episode.task, self._base_url)
            for tab, episode in missing.items()
            if self._states[tab].task != episode.task or needs_fresh_document(episode.task)
        }
        failures = self._tabs.navigate(urls) if urls else {}
        requests = {tab: pages.start_call(episode) for tab, episode in missing.items() if tab not in failures}
        for tab, outcome in self._tabs.ask(requests, opening=True).items():
            answer = decode(outcome, self._view)
            if isinstance(answer, Failure):
                failures[tab] = answer
            elif answer.page is None or answer.goal is None:
                failures[tab] = Failure(cause="page_error", message="the answer has no page or no goal")
            else:
                state = self._states[tab]
                state.task, state.episode, state.goal = missing[tab].task, missing[tab], answer.goal
                opened[tab] = Observation(episode=missing[tab], page=answer.page, goal=answer.goal)
        return failures

    def _lose(self, tab: int, failure: Failure) -> None:
        """Mark the tab's episode as lost, and recover the tab."""
        self._states[tab].lost = failure.cause
        self._recover(tab, failure, attempt=0)

    def _recover(self, tab: int, failure: Failure, *, attempt: int) -> None:
        """Bring the tab into a state in which it can load a document, by stronger means with each attempt."""
        self._on_restart(failure.cause)
        self._states[tab].task = None
        if self._tabs.has_crashed(tab) or attempt == 1:
            for other in self._tabs.rebuild(tab):
                self._states[other].task = None
                if other != tab and self._states[other].episode is not None and not self._states[other].lost:
                    self._on_restart("tab_crashed")
                    self._states[other].lost = "tab_crashed"
        elif attempt == 2 and failure.cause != "page_error":  # a new Chrome does not repair an error of the page
            raise BrowserGone(f"tab {tab} does not recover: {failure}")

    def _relaunch(self) -> None:
        self._on_restart("browser_died")
        for state in self._states:
            state.task = None
            if state.episode is not None:
                state.lost = "browser_died"
        self._tabs.launch()
