"""K tabs of one Chrome: evaluates in many at once, navigates many at once, and says what went wrong."""

from __future__ import annotations

import base64
import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import tenacity

from browser_farm import pages
from browser_farm.chrome.answers import Failure, answers_of, evaluated
from browser_farm.chrome.devtools import BROWSER, BrowserGone, DevTools, Json, Reply, browser_url
from browser_farm.chrome.hub import Hub, Tab
from browser_farm.chrome.launcher import Chrome, LaunchFailed

LAUNCH_ATTEMPTS = 3
LONGEST_BACK_OFF_S = 5.0
PROCESSES = 2  # renderers that share the tabs, so that one page computes while another is read
OPENING = 4  # times as long as a call may take may a document take to open
LARGEST_HUB = 16  # tabs of one renderer, which live and die together


class Tabs:
    """Its methods raise BrowserGone once Chrome is dead or silent; `launch` starts another."""

    def __init__(
        self,
        count: int,
        *,
        view: pages.View,
        call_timeout_s: float,
        launch_timeout_s: float,
        headless: bool,
        no_sandbox: bool | None,
    ) -> None:
        self._count = count
        self._view = view
        self._call_timeout_s = call_timeout_s
        self._launch_timeout_s = launch_timeout_s
        self._headless = headless
        self._no_sandbox = no_sandbox
        self._chrome: Chrome | None = None
        self._devtools: DevTools | None = None
        self._hubs: list[Hub] = []

    @property
    def chrome(self) -> Chrome:
        assert self._chrome is not None, "launch() comes first"
        return self._chrome

    def launch(self) -> None:
        """End the Chrome there is, if any, and start another with its tabs; RuntimeError after 3 tries."""
        attempts = tenacity.Retrying(
            stop=tenacity.stop_after_attempt(LAUNCH_ATTEMPTS),
            wait=tenacity.wait_random_exponential(multiplier=0.5, max=LONGEST_BACK_OFF_S),
            retry=tenacity.retry_if_exception_type((LaunchFailed, BrowserGone, TimeoutError)),
        )
        try:
            attempts(self._launch_once)
        except tenacity.RetryError as error:
            last = error.last_attempt.exception()
            raise RuntimeError(f"Chrome did not start in {LAUNCH_ATTEMPTS} attempts: {last}") from last

    def close(self) -> None:
        if self._devtools is not None:
            self._devtools.close()
            self._devtools = None
        if self._chrome is not None:
            self._chrome.end()
            self._chrome = None
        self._hubs.clear()

    def ask(self, questions: Mapping[int, pages.Json], *, opening: bool = False) -> dict[int, Any | Failure]:
        """Ask the pages of many tabs, and have their answers as values; a page that still loads is waited for."""
        answers = self._ask_hubs(questions, OPENING if opening else 1)
        later = {tab: pages.LATER for tab, answer in answers.items() if answer == pages.WAIT}
        for tab, text in (self.evaluate(later, promised=True) if later else {}).items():
            answers[tab] = json.loads(text) if isinstance(text, str) else text
        return answers

    def _ask_hubs(self, questions: Mapping[int, pages.Json], patience: int) -> dict[int, Any | Failure]:
        """One call for each process.

        A page that does not come back is interrupted; the tabs behind it in its process are asked again.
        """
        answers: dict[int, Any | Failure] = {}
        while left := {tab: words for tab, words in questions.items() if tab not in answers}:
            asked: dict[int, tuple[Hub, int, list[int]]] = {}  # message -> whom, call, which of its tabs
            for hub in self._hubs:
                if mine := {tab: words for tab, words in left.items() if tab in hub.tabs}:
                    number, message = hub.ask(mine)
                    asked[message] = (hub, number, list(mine))

            def given_up(asked: dict[int, tuple[Hub, int, list[int]]] = asked) -> set[int]:
                return {message for message, (hub, _, _) in asked.items() if hub.crashed}

            replies = self._receive(asked, patience, given_up)
            for message, (hub, number, tabs) in asked.items():
                if message in replies:
                    answers |= answers_of(replies[message], tabs)
                elif hub.crashed:
                    answers |= dict.fromkeys(tabs, Failure(cause="tab_crashed"))
                else:
                    answers |= self._break_off(hub, number, tabs)
        return answers

    def _break_off(self, hub: Hub, number: int, tabs: list[int]) -> dict[int, Any | Failure]:
        """What is known of a call that did not end in time: at least one failure."""
        self._check_alive()
        culprit, said = hub.break_off(number, timeout_s=self._call_timeout_s)
        if culprit is None:  # none of those asked: something else in that process never ends
            return dict.fromkeys(tabs, self._hung())
        return {**said, culprit: self._hung()}

    def evaluate(self, expressions: Mapping[int, str], *, promised: bool = False) -> dict[int, str | Failure]:
        """Run one expression in each tab, all at the same time; each gives a string, or promises one."""
        params = {
            tab: {"expression": expression, "returnByValue": True, "awaitPromise": promised}
            for tab, expression in expressions.items()
        }
        replies = self._call_all("Runtime.evaluate", params, patience=OPENING if promised else 1)
        return {tab: reply if isinstance(reply, Failure) else evaluated(reply) for tab, reply in replies.items()}

    def navigate(self, urls: Mapping[int, str]) -> dict[int, Failure]:
        """Show a url in each tab, all at the same time; only those that failed are in the answer."""
        replies = self._call_all("Page.navigate", {tab: {"url": url} for tab, url in urls.items()}, patience=OPENING)
        failures: dict[int, Failure] = {}
        for tab, reply in replies.items():
            if isinstance(reply, Failure):
                failures[tab] = reply
            elif reply.error or reply.result.get("errorText"):
                words = reply.error or str(reply.result["errorText"])
                failures[tab] = Failure(cause="navigated", words=words)
        return failures

    def input(self, wanted: Mapping[int, Sequence[tuple[str, Json]]]) -> dict[int, Failure]:
        """Send each tab its events in order, all tabs at the same time; only those that failed are in the answer."""
        calls = {
            tab: {self._tools.send(self._tab(tab).session, method, params) for method, params in events}
            for tab, events in wanted.items()
        }

        def given_up() -> set[int]:
            return {call for tab, mine in calls.items() if self.has_crashed(tab) for call in mine}

        replies = self._receive(set().union(*calls.values()), 1, given_up)
        late = [tab for tab, mine in calls.items() if not mine <= replies.keys()]
        if any(not self.has_crashed(tab) for tab in late):
            self._interrupt(late)
        return {tab: Failure(cause="tab_crashed") if self.has_crashed(tab) else self._hung() for tab in late}

    def _interrupt(self, tabs: Sequence[int]) -> None:
        """Stop the scripts of the processes that these tabs live in; BrowserGone when Chrome is silent altogether."""
        self._check_alive()
        for hub in {id(hub): hub for hub in map(self._hub, tabs)}.values():
            hub.interrupt(timeout_s=self._call_timeout_s)

    def screenshot(self, tab: int, box: tuple[float, float, float, float], scale: float) -> bytes | Failure:
        """A part of a page as PNG. The tab is shown meanwhile: Chrome draws no other."""
        clip = dict(zip(("x", "y", "width", "height"), box, strict=True)) | {"scale": scale}
        shot = {"format": "png", "clip": clip, "optimizeForSpeed": True}
        reply = self._call_all("Page.bringToFront", {tab: {}})[tab]
        if not isinstance(reply, Failure):
            reply = self._call_all("Page.captureScreenshot", {tab: shot})[tab]
        self._step_aside()
        if isinstance(reply, Failure):
            return reply
        if not reply.result:
            return Failure(cause="page_error", words=reply.error)
        return base64.b64decode(reply.result["data"])

    def rebuild(self, tab: int) -> set[int]:
        """Give up the process that a tab lives in, and open all of its tabs anew; they are named."""
        index = self._hubs.index(self._hub(tab))
        old = self._hubs[index]
        old.close()
        self._hubs[index] = self._open_hub(list(old.tabs))
        self._step_aside()
        return set(old.tabs)

    def has_crashed(self, tab: int) -> bool:
        """Whether the process of this tab is gone."""
        return self._hub(tab).crashed

    def show(self, tab: int) -> None:
        """Bring a tab to the front, where a person can see and use it."""
        self._tools.post(self._tab(tab).session, "Page.bringToFront")

    @property
    def _tools(self) -> DevTools:
        if self._devtools is None:
            raise BrowserGone("Chrome is not running")
        return self._devtools

    def _launch_once(self) -> None:
        self.close()
        self._chrome = Chrome(headless=self._headless, no_sandbox=self._no_sandbox, timeout_s=self._launch_timeout_s)
        url = browser_url(self._chrome.debugger_address, timeout_s=self._launch_timeout_s)
        self._devtools = DevTools(url, timeout_s=self._launch_timeout_s, on_event=self._on_event)
        hubs = max(min(self._count, PROCESSES), math.ceil(self._count / LARGEST_HUB))
        self._hubs = [self._open_hub(range(self._count)[first::hubs]) for first in range(hubs)]
        # What Chrome began with has a process of its own.
        self._devtools.post(BROWSER, "Target.closeTarget", {"targetId": self._chrome.first_target})
        self._step_aside()

    def _open_hub(self, numbers: Sequence[int]) -> Hub:
        tools = self._tools
        try:
            return Hub(tools, self.chrome.hub_url, numbers, view=self._view, timeout_s=self._launch_timeout_s)
        except (TimeoutError, RuntimeError) as error:
            raise BrowserGone(f"Chrome opens no tab: {error}") from error

    def _step_aside(self) -> None:
        """Show what draws nothing: a tab that is shown draws frames."""
        self._tools.post(BROWSER, "Target.activateTarget", {"targetId": self._hubs[0].page.target})

    def _hub(self, tab: int) -> Hub:
        return next(hub for hub in self._hubs if tab in hub.tabs)

    def _tab(self, tab: int) -> Tab:
        return self._hub(tab).tabs[tab]

    def _call_all(self, method: str, params: Mapping[int, Json], *, patience: int = 1) -> dict[int, Reply | Failure]:
        calls = {tab: self._tools.send(self._tab(tab).session, method, each) for tab, each in params.items()}

        def given_up() -> set[int]:
            return {call for tab, call in calls.items() if self.has_crashed(tab)}

        replies = self._receive(calls.values(), patience, given_up)
        answers: dict[int, Reply | Failure] = {}
        for tab, call in calls.items():
            if call in replies:
                answers[tab] = replies[call]
            elif self.has_crashed(tab):
                answers[tab] = Failure(cause="tab_crashed")
            else:
                answers[tab] = self._hung()
        hung = [tab for tab, answer in answers.items() if isinstance(answer, Failure) and answer.cause == "page_hung"]
        if hung:
            self._interrupt(hung)
        return answers

    def _receive(self, calls: Iterable[int], patience: int, given_up: Callable[[], set[int]]) -> dict[int, Reply]:
        """What came within so many times the time of a call. A Chrome that is silent itself is not waited for."""
        left, replies = set(calls), dict[int, Reply]()
        for turn in range(1, patience + 1):
            deadline = time.monotonic() + self._call_timeout_s
            replies |= self._tools.receive(left, deadline=deadline, given_up=given_up, again=turn < patience)
            left -= replies.keys() | given_up()
            if not left:
                break
            if turn < patience:
                self._check_alive()
        return replies

    def _hung(self) -> Failure:
        return Failure(cause="page_hung", words=f"no answer in {self._call_timeout_s:g} s")

    def _check_alive(self) -> None:
        try:
            self._tools.call(BROWSER, "Browser.getVersion", timeout_s=self._call_timeout_s / 2)
        except TimeoutError as error:
            raise BrowserGone(str(error)) from error

    def _on_event(self, session: str, method: str, params: Json) -> None:
        if method == "Page.javascriptDialogOpening":
            self._tools.post(session, "Page.handleJavaScriptDialog", {"accept": True})
        elif method in ("Inspector.targetCrashed", "Target.detachedFromTarget"):
            gone = params.get("sessionId", session)
            for tab in (tab for hub in self._hubs for tab in (hub.page, *hub.tabs.values())):
                tab.crashed |= tab.session == gone
