"""Real Chrome behind the Browser port: steps many episodes at once, and outlives whatever breaks."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from browser_farm import pages
from browser_farm.chrome import trusted_input
from browser_farm.chrome.answers import Failure
from browser_farm.chrome.devtools import BrowserGone
from browser_farm.chrome.tabs import Tabs
from browser_farm.tasks import needs_fresh_document, page_url
from giirl_core.types import Command, EpisodeSpec, Goal, Observation, StepResult, Verb

OPEN_ATTEMPTS = 4  # as the tab is, in a mended tab, in another tab, in another Chrome


def _tell_nobody(cause: str) -> None:
    del cause


@dataclass(slots=True, kw_only=True)
class Shown:
    """What one tab shows."""

    task: str | None = None  # whose document is loaded; None makes the next episode load one
    episode: EpisodeSpec | None = None  # under way
    goal: Goal | None = None  # of that episode
    lost: str = ""  # why the episode broke off, until the next step can say so


class ChromeFarm:
    """A `giirl_core.types.Browser` of `tabs` tabs in one Chrome of its own.

    Whatever happens to a page or to Chrome costs the episodes concerned (`StepResult.lost`) and is told to
    `on_restart`: "page_hung", "tab_crashed", "navigated" or "page_error" once for each tab, "browser_died"
    once for each Chrome. A call returns or raises within a few times `call_timeout_s` and `launch_timeout_s`.
    Only a Chrome that cannot be started, or a page that never opens, is a RuntimeError.
    """

    def __init__(
        self,
        *,
        tabs: int = 8,
        call_timeout_s: float = 10.0,
        launch_timeout_s: float = 60.0,
        headless: bool = True,
        no_sandbox: bool | None = None,  # None: only as root, where Chrome refuses to run otherwise
        view: pages.View = pages.ROWS,
        trusted: bool = False,  # act through Chrome's own mouse and keyboard instead of DOM events
        on_restart: Callable[[str], None] = _tell_nobody,
    ) -> None:
        if tabs < 1:
            raise ValueError(f"ChromeFarm.tabs is {tabs}: wanted at least 1")
        for name, value in (("call_timeout_s", call_timeout_s), ("launch_timeout_s", launch_timeout_s)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"ChromeFarm.{name} is {value}: wanted a number of seconds above 0")
        self.tabs = tabs
        self._view = replace(view, emulation=(*view.emulation, *trusted_input.EMULATION)) if trusted else view
        self._trusted = trusted
        self._on_restart = on_restart
        self._shown = [Shown() for _ in range(tabs)]
        self._closed = False
        self._tabs = Tabs(
            tabs,
            view=self._view,
            call_timeout_s=call_timeout_s,
            launch_timeout_s=launch_timeout_s,
            headless=headless,
            no_sandbox=no_sandbox,
        )
        try:
            self._tabs.launch()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> ChromeFarm:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def chrome_directory(self) -> str:
        """Where this farm's Chrome keeps its profile: the mark by which its processes are known."""
        return str(self._tabs.chrome.directory)

    def reset(self, episodes: Mapping[int, EpisodeSpec]) -> dict[int, Observation]:
        self._check(episodes)
        for episode in episodes.values():
            page_url(episode.task)
        return self._open(dict(episodes))

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        self._check(commands)
        calls: dict[int, pages.Json] = {}
        for command in commands.values():
            if command.following is not None:
                page_url(command.following.task)
        done_by_hand = self._use_hands(commands) if self._trusted else set()
        for tab, command in commands.items():
            shown = self._shown[tab]
            if shown.episode is None:
                raise ValueError(f"tab {tab} shows no episode: reset it before it steps")
            if not shown.lost:
                acts = replace(command, verb=Verb.WAIT) if tab in done_by_hand else command
                calls[tab] = pages.step_call(acts, shown.episode.task)
        answers = self._ask(calls)
        results: dict[int, StepResult] = {}
        opening: dict[int, EpisodeSpec] = {}
        for tab, command in commands.items():
            results[tab] = self._advance(tab, command, answers.get(tab))
            if results[tab].observation is None and command.following is not None:
                opening[tab] = command.following
        for tab, observation in self._open(opening).items():
            results[tab] = replace(results[tab], observation=observation)
        return results

    def picture(self, tab: int, box: tuple[float, float, float, float], *, scale: float = 1.0) -> bytes:
        """PNG of a part of what a tab shows: left, top, width, height in CSS px, each `scale` dots wide.

        A tab that does not answer gives none, and is lost at its next step.
        """
        self._check({tab: None})
        if self._shown[tab].lost:
            return b""
        try:
            png = self._tabs.screenshot(tab, box, scale)
        except BrowserGone:
            self._relaunch()
            return b""
        if isinstance(png, Failure):
            self._shown[tab].lost = png.cause
            self._mend(tab, png, attempt=0)
            return b""
        return png

    def screenshots(self, tabs: Iterable[int], width: int, height: int) -> dict[int, NDArray[np.uint8]]:
        """[height, width, 3] RGB of each tab's upper left corner, one after the other: only a shown tab is drawn.

        A tab that does not answer is black here and lost at its next step.
        """
        pictures = {tab: np.zeros((height, width, 3), dtype=np.uint8) for tab in tabs}
        for tab, picture in pictures.items():
            if png := self.picture(tab, (0, 0, width, height)):
                picture[:] = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
        return pictures

    def close(self) -> None:
        self._closed = True
        self._tabs.close()

    def _check(self, wanted: Mapping[int, object]) -> None:
        if self._closed:
            raise RuntimeError("this ChromeFarm is closed")
        for tab in wanted:
            if not 0 <= tab < self.tabs:
                raise ValueError(f"there is no tab {tab}: wanted 0 to {self.tabs - 1}")

    def _ask(self, calls: Mapping[int, pages.Json]) -> dict[int, pages.Answer]:
        """Answers of the pages; a tab without one has been marked lost and mended."""
        answers: dict[int, pages.Answer] = {}
        if not calls:
            return answers
        try:
            for tab, outcome in self._tabs.ask(calls).items():
                answer = _read(outcome, self._view)
                if isinstance(answer, Failure):
                    self._shown[tab].lost = answer.cause
                    self._mend(tab, answer, attempt=0)
                else:
                    answers[tab] = answer
        except BrowserGone:
            self._relaunch()
            return {}
        return answers

    def _use_hands(self, commands: Mapping[int, Command]) -> set[int]:
        """Do what a mouse and a keyboard can do; the tabs where that was all of it."""
        able = {tab: c for tab, c in commands.items() if self._shown[tab].episode and not self._shown[tab].lost}
        sent: set[int] = set()
        try:
            aims = self._tabs.ask({tab: pages.aim_call(command) for tab, command in able.items()})
            wanted = {tab: trusted_input.events(able[tab], aim) for tab, aim in aims.items() if isinstance(aim, list)}
            for tab, failure in self._tabs.input(wanted).items():
                self._shown[tab].lost = failure.cause
                self._mend(tab, failure, attempt=0)
            turned = {tab: pages.DRAWN for tab in wanted if able[tab].verb is Verb.SCROLL and not self._shown[tab].lost}
            if turned:
                self._tabs.evaluate(turned, promised=True)
            sent = set(wanted)
        except BrowserGone:
            self._relaunch()
        return sent

    def _advance(self, tab: int, command: Command, answer: pages.Answer | None) -> StepResult:
        """Note what the tab shows now; the result lacks an observation where the farm has to open one."""
        shown = self._shown[tab]
        if shown.lost or answer is None:
            result = StepResult(raw_reward=0.0, done=False, observation=None, lost=shown.lost)
            shown.episode, shown.goal, shown.lost = None, None, ""
            return result
        if answer.done or command.last:
            shown.episode, shown.goal = (command.following if answer.page is not None else None), answer.goal
        observation = None
        if answer.page is not None and shown.episode is not None and shown.goal is not None:
            observation = Observation(episode=shown.episode, page=answer.page, goal=shown.goal)
        return StepResult(raw_reward=answer.raw_reward, done=answer.done, observation=observation, reason=answer.reason)

    def _open(self, wanted: dict[int, EpisodeSpec]) -> dict[int, Observation]:
        """Open an episode in each tab, mending what breaks on the way."""
        opened: dict[int, Observation] = {}
        last = Failure(cause="")
        for tab in wanted:
            self._shown[tab].episode, self._shown[tab].lost = None, ""
        for attempt in range(OPEN_ATTEMPTS):
            missing = {tab: episode for tab, episode in wanted.items() if tab not in opened}
            if not missing:
                break
            try:
                for tab, failure in self._try_open(missing, opened).items():
                    last = failure
                    self._mend(tab, failure, attempt=attempt)
            except BrowserGone as error:
                last = Failure(cause="browser_died", words=str(error))
                self._relaunch()
                opened.clear()
                for tab in wanted:
                    self._shown[tab].episode, self._shown[tab].lost = None, ""
        for tab, episode in wanted.items():
            if tab not in opened:
                raise RuntimeError(
                    f"task {episode.task} with seed {episode.seed} does not open in tab {tab} "
                    f"after {OPEN_ATTEMPTS} attempts: {last.cause} {last.words}".rstrip()
                )
        return {tab: opened[tab] for tab in wanted}

    def _try_open(self, missing: Mapping[int, EpisodeSpec], opened: dict[int, Observation]) -> dict[int, Failure]:
        urls = {
            tab: page_url(episode.task)
            for tab, episode in missing.items()
            if self._shown[tab].task != episode.task or needs_fresh_document(episode.task)
        }
        failures = self._tabs.navigate(urls) if urls else {}
        calls = {tab: pages.start_call(episode) for tab, episode in missing.items() if tab not in failures}
        for tab, outcome in self._tabs.ask(calls, opening=True).items():
            answer = _read(outcome, self._view)
            if isinstance(answer, Failure):
                failures[tab] = answer
            elif answer.page is None or answer.goal is None:
                failures[tab] = Failure(cause="page_error", words="the page answered without a page")
            else:
                shown = self._shown[tab]
                shown.task, shown.episode, shown.goal = missing[tab].task, missing[tab], answer.goal
                opened[tab] = Observation(episode=missing[tab], page=answer.page, goal=answer.goal)
        return failures

    def _mend(self, tab: int, failure: Failure, *, attempt: int) -> None:
        """Leave the tab so that loading a document in it can succeed; each attempt reaches for more."""
        self._on_restart(failure.cause)
        self._shown[tab].task = None
        if self._tabs.has_crashed(tab) or attempt == 1:
            for other in self._tabs.rebuild(tab):
                self._shown[other].task = None
                if other != tab and self._shown[other].episode is not None and not self._shown[other].lost:
                    self._on_restart("tab_crashed")
                    self._shown[other].lost = "tab_crashed"
        elif attempt == 2 and failure.cause != "page_error":  # a new Chrome does not mend a page's own mistake
            raise BrowserGone(f"tab {tab} does not come back: {failure.cause} {failure.words}".rstrip())

    def _relaunch(self) -> None:
        self._on_restart("browser_died")
        for shown in self._shown:
            shown.task = None
            if shown.episode is not None:
                shown.lost = "browser_died"
        self._tabs.launch()


def _read(outcome: Any | Failure, view: pages.View) -> pages.Answer | Failure:
    if isinstance(outcome, Failure):
        return outcome
    if outcome == pages.GONE:
        return Failure(cause="navigated")
    try:
        return pages.decode(outcome, view)
    except (ValueError, TypeError, OverflowError) as error:
        return Failure(cause="page_error", words=str(error))
