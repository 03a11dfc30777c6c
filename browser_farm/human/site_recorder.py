"""Records a person on pages of their own: the page in one window, the instruction and their choices in another."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TypeVar

from browser_farm import pages
from browser_farm.chrome.answers import Failure
from browser_farm.chrome.devtools import BrowserGone, Json
from browser_farm.human.bar import AT_THE_END, ON_THE_WAY, Bar, Choice
from browser_farm.human.passwords import Passwords
from browser_farm.human.site_steps import SiteSteps
from browser_farm.human.steps import POLL_S, Interrupted, episode_of
from browser_farm.sites.browser import SiteBrowser
from browser_farm.sites.episode import FILES_REFUSED, Episode
from browser_farm.sites.page import Dialog
from browser_farm.sites.routines import Routine, TabFailed, Wait, run_all
from browser_farm.sites.session import WORLD, Session
from giirl_core.config.sections import Sandbox
from giirl_core.types import Episode as RecordedEpisode
from giirl_core.types import EpisodeSpec, Outcome

T = TypeVar("T")
OPEN_ATTEMPTS = 2  # the second is for an application that restarts
TAB = 0
GONE = "tab_crashed"  # cause of a failure: the window was closed, too
BINDING = {"name": "giirlStep", "executionContextName": WORLD}  # of site_recorder.js
# Chrome adds bindings to the contexts that it reports.
CALLS: Sequence[tuple[str, Json]] = (("Runtime.enable", {}), ("Runtime.addBinding", BINDING))
LISTEN = "window.giirlRecorder ? (giirlRecorder.listen(), true) : false"
PASSING = frozenset({"not_quiet", "unreachable"})  # causes that a person can wait for, or do something about
FAILED = -1.0  # raw reward


class SiteRecorder:
    """One Chrome with two windows: the page of a task file, and the bar.

    Timeouts are in seconds. `chrome_sandbox` is as in `browser_farm.farm.ChromeFarm`. Passwords are looked for in
    `environment`; `unset_variables` are those that have to be set before a demonstration can be played again.
    """

    def __init__(
        self,
        tasks: Sequence[str],
        *,
        headless: bool = False,
        call_timeout_s: float = 10.0,
        launch_timeout_s: float = 60.0,
        chrome_sandbox: Sandbox = "auto",
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        self._passwords = Passwords(environment)
        self._opened_bar: Bar | None = None
        self._session: Session | None = None
        self._steps = SiteSteps(1.0)
        self._dialog: Dialog | None = None
        self._end: BaseException | None = None  # what ended the recording while an episode was complete
        self._browser = SiteBrowser(
            tasks,
            headless=headless,
            sandbox=chrome_sandbox,
            call_timeout_s=call_timeout_s,
            launch_timeout_s=launch_timeout_s,
            on_event=self._hear,
        )
        try:
            self._browser.launch()
            self._opened_bar = Bar(self._browser.tools, self._browser.chrome.first_target, call_timeout_s)
        except BaseException:
            self.close()
            raise

    @property
    def unset_variables(self) -> list[str]:
        """Variables of the environment that stand for passwords and are not set."""
        return self._passwords.unset

    def close(self) -> None:
        """Close Chrome."""
        self._browser.close()

    def record(
        self, spec: EpisodeSpec, show_instruction: Callable[[str], None], progress: str = "", note: str = ""
    ) -> RecordedEpisode | None:
        """Open a page, pass its instruction to `show_instruction`, and wait for what the person does and says.

        `progress` and `note` are shown in the bar. None for an episode that was discarded, or has no action.
        RuntimeError, one line, for a page that does not open; Interrupted if the page broke; BrowserGone if a window
        was closed. An episode that is complete when that happens, or at a KeyboardInterrupt, is returned; the next
        call then raises.
        """
        if self._end is not None:
            raise self._end
        while True:
            choice, recorded = self._record(spec, show_instruction, progress, note)
            if choice is not Choice.REDO:
                return recorded

    def _record(
        self, spec: EpisodeSpec, show_instruction: Callable[[str], None], progress: str, note: str
    ) -> tuple[Choice, RecordedEpisode | None]:
        self._bar.renew()
        self._bar.show(progress, "", "The page is being opened.", ())
        try:
            episode = self._open(spec)
            goal = episode.drawn.goal
            self._bar.place(episode.session.target, episode.task.file.viewport)
            show_instruction(goal.utterance)
            choice = self._run(self._until_over(episode, progress, note))
            reward = 0.0
            if choice in (None, Choice.DONE):
                reward = self._run(episode.verdict(done=True))
            if choice is None:
                choice = self._review(episode, progress, reward)
            if choice in (Choice.REDO, Choice.DISCARD):
                return choice, None
            outcome = Outcome(raw_reward=FAILED if choice is Choice.FAILED else reward, ended=True)
            steps = self._passwords.hide(self._steps.recorded, goal, episode.drawn.values)
            return choice, episode_of(spec, goal, steps, outcome)
        finally:
            self._leave()

    def _open(self, spec: EpisodeSpec) -> Episode:
        failure = Failure(cause="")
        for _ in range(OPEN_ATTEMPTS):
            self._leave()
            most = self._browser.tasks[spec.task].file.max_elements
            script = "\n".join([f"const MOST = {most};", *map(pages.source, ("person", "site_recorder"))])
            episode, opening = self._browser.begin(spec, script, CALLS)
            self._session = episode.session
            opened = run_all(self._browser.tools, {TAB: opening})[TAB]
            if not isinstance(opened, Failure):
                self._steps = SiteSteps(episode.scale)  # what was done while the page was opening does not count
                self._steps.see(opened.page)
                return episode
            failure = opened
        raise RuntimeError(f"{spec.task} does not open: {failure.cause} {failure.message}".rstrip())

    def _leave(self) -> None:
        """End the page and its browser context."""
        session, self._session, self._dialog = self._session, None, None
        if session is not None:
            with suppress(BrowserGone):
                session.close()

    def _run(self, routine: Routine[T]) -> T:
        """What a routine returns. BrowserGone if a window is gone, Interrupted for any other failure."""
        outcome = run_all(self._browser.tools, {TAB: routine})[TAB]
        if isinstance(outcome, Failure) and outcome.cause == GONE:
            raise BrowserGone("the window was closed or crashed")
        if isinstance(outcome, Failure):
            raise Interrupted(f"{outcome.cause} {outcome.message}".strip())
        return outcome

    # ---- what the person does

    def _until_over(self, episode: Episode, progress: str, note: str) -> Routine[Choice | None]:
        """Wait until the page has ended the episode, None, or the person has said something about it."""
        session, end, refused = episode.session, episode.task.file.end, 0
        while True:
            shown = f"{progress}; actions so far: {len(self._steps)}"
            self._bar.show(shown, episode.drawn.goal.utterance, note, ON_THE_WAY)
            choice = yield from self._choice(time.monotonic() + POLL_S)
            if choice is not None:
                return choice
            if session.file_chooser:
                session.file_chooser, note = False, FILES_REFUSED
            if len(session.refused) > refused:
                refused = len(session.refused)
                note = f"the origin of {session.refused[-1]} is not among the allowed"
            try:
                page = yield from episode.look()
            except TabFailed as error:
                if error.failure.cause not in PASSING:
                    raise
                note = error.failure.message
                continue
            if session.dialog is None:
                self._steps.see(page)
                yield from session.evaluate(LISTEN)
                if end and len(self._steps) and (yield from episode.holds(end)):
                    return None

    def _review(self, episode: Episode, progress: str, reward: float) -> Choice:
        """What the person says about an episode that the page has ended. It is kept if they leave without a word."""
        verdict = "succeeded" if reward == 1.0 else "failed"
        note = f"The page has ended the episode: it {verdict}."
        self._bar.show(progress, episode.drawn.goal.utterance, note, AT_THE_END)
        try:
            choice = self._run(self._choice(math.inf))
        except (BrowserGone, KeyboardInterrupt) as error:
            self._end, choice = error, None
        return choice or Choice.KEEP

    def _choice(self, deadline: float) -> Routine[Choice | None]:
        """What the person chooses in the bar before a deadline (`time.monotonic`)."""
        while self._bar.choice is None and time.monotonic() < deadline:
            if self._bar.is_closed or (self._session is not None and self._session.crashed):
                raise TabFailed(GONE)
            yield Wait(lambda: self._bar.choice is not None, min(deadline, time.monotonic() + POLL_S))
        return self._bar.choice

    # ---- events

    def _hear(self, session: str, method: str, params: Json) -> None:
        if self._opened_bar is not None:
            self._opened_bar.hear(session, method, params)
        if self._session is None:
            return
        self._session.hear(session, method, params)
        if session != self._session.id:
            return
        if method == "Runtime.bindingCalled" and params.get("name") == BINDING["name"]:
            self._steps.take(int(params["executionContextId"]), str(params["payload"]))
        elif method == "Page.javascriptDialogOpening":
            self._dialog = self._session.dialog
        elif method == "Page.javascriptDialogClosed" and self._dialog is not None:
            dialog, self._dialog = self._dialog, None
            self._steps.answer(dialog, accepted=bool(params["result"]), text=str(params.get("userInput", "")))

    @property
    def _bar(self) -> Bar:
        assert self._opened_bar is not None
        return self._opened_bar
