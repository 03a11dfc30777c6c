"""K tabs of one Chrome: calls to many tabs at once, and a Failure for each tab that returns nothing."""

from __future__ import annotations

import base64
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import tenacity

from browser_farm import pages
from browser_farm.chrome.answers import Failure, parse_evaluation
from browser_farm.chrome.devtools import BROWSER, BrowserGone, DevTools, Json, Reply, browser_url
from browser_farm.chrome.hub import Hub, Tab
from browser_farm.chrome.launcher import Chrome, LaunchFailed
from giirl_core.config.sections import Sandbox

LAUNCH_ATTEMPTS = 3
MAX_BACKOFF_S = 5.0
PROCESSES = 2  # renderers that share the tabs, so that one page computes while another is read
MAX_TABS_PER_PROCESS = 16  # they crash together
OPENING_PERIODS = 4  # a document may take this many times the timeout of a call to open


def try_launching(launch: Callable[[], None]) -> None:
    """Launch a Chrome, again after a failure.

    RuntimeError after 3 attempts, or after the first if another would fail alike.
    """
    attempts = tenacity.Retrying(
        stop=tenacity.stop_after_attempt(LAUNCH_ATTEMPTS),
        wait=tenacity.wait_random_exponential(multiplier=0.5, max=MAX_BACKOFF_S),
        retry=tenacity.retry_if_exception_type((LaunchFailed, BrowserGone, TimeoutError)),
    )
    try:
        attempts(launch)
    except tenacity.RetryError as error:
        last = error.last_attempt.exception()
        raise RuntimeError(f"Chrome did not start in {LAUNCH_ATTEMPTS} attempts: {last}") from last


class Tabs:
    """The tabs and the Chrome they live in.

    Methods raise BrowserGone when Chrome has died or no longer answers; `launch` then starts another Chrome. What goes
    wrong in one tab is returned as its Failure.
    """

    def __init__(
        self,
        count: int,
        *,
        view: pages.View,
        call_timeout_s: float,
        launch_timeout_s: float,
        headless: bool,
        sandbox: Sandbox,
        base_url: str = "",
    ) -> None:
        self._owner = os.getpid()
        self._count = count
        self._view = view
        self._call_timeout_s = call_timeout_s
        self._launch_timeout_s = launch_timeout_s
        self._headless = headless
        self._sandbox = sandbox
        self._base_url = base_url
        self._chrome: Chrome | None = None
        self._devtools: DevTools | None = None
        self._hubs: list[Hub] = []

    @property
    def chrome(self) -> Chrome:
        assert self._chrome is not None, "launch() comes first"
        return self._chrome

    def launch(self) -> None:
        """End the current Chrome, if any, and start another with its tabs.

        RuntimeError as `try_launching`.
        """
        try_launching(self._launch_once)

    def close(self) -> None:
        if self._devtools is not None:
            self._devtools.close()
            self._devtools = None
        if self._chrome is not None:
            self._chrome.end()
            self._chrome = None
        self._hubs.clear()

    def ask(self, requests: Mapping[int, pages.Json], *, opening: bool = False) -> dict[int, Any | Failure]:
        """Send each tab a request of page.js and return the answers, decoded from JSON.

        All tabs of a process are asked in one call. If a page blocks it, the tabs that waited behind that page are
        asked again. A page that is still loading is waited for.
        """
        answers: dict[int, Any | Failure] = {}
        while unanswered := {tab: request for tab, request in requests.items() if tab not in answers}:
            calls: dict[int, Hub] = {}
            for hub in self._hubs:
                if own := {tab: request for tab, request in unanswered.items() if tab in hub.tabs}:
                    calls[hub.ask(own)] = hub
            periods = OPENING_PERIODS if opening else 1
            replies = self._tools.receive(calls, timeout_s=self._call_timeout_s, periods=periods)
            for call, hub in calls.items():
                answers |= hub.answers(replies.get(call), timeout_s=self._call_timeout_s)
        loading = {tab: pages.PENDING_ANSWER for tab, answer in answers.items() if answer == pages.WAIT}
        for tab, text in (self.evaluate(loading, await_promise=True) if loading else {}).items():
            answers[tab] = json.loads(text) if isinstance(text, str) else text
        return answers

    def evaluate(self, expressions: Mapping[int, str], *, await_promise: bool = False) -> dict[int, str | Failure]:
        """Run one expression in each tab, all at the same time. Each returns a string, or a promise of one."""
        calls = {}
        for tab, expression in expressions.items():
            params = {"expression": expression, "returnByValue": True, "awaitPromise": await_promise}
            calls[tab] = [("Runtime.evaluate", params)]
        replies = self._call_all(calls, periods=OPENING_PERIODS if await_promise else 1)
        return {tab: reply if isinstance(reply, Failure) else parse_evaluation(reply) for tab, reply in replies.items()}

    def navigate(self, urls: Mapping[int, str]) -> dict[int, Failure]:
        """Load a URL in each tab, all at the same time; returns only the failures."""
        calls = {tab: [("Page.navigate", {"url": url})] for tab, url in urls.items()}
        failures: dict[int, Failure] = {}
        for tab, reply in self._call_all(calls, periods=OPENING_PERIODS).items():
            if isinstance(reply, Failure):
                failures[tab] = reply
            elif reply.error or reply.result.get("errorText"):
                failures[tab] = Failure(cause="navigated", message=reply.error or str(reply.result["errorText"]))
        return failures

    def send_input(self, events: Mapping[int, Sequence[tuple[str, Json]]]) -> dict[int, Failure]:
        """Send each tab its input events in order, all tabs at the same time; returns only the failures."""
        replies = self._call_all({tab: calls for tab, calls in events.items() if calls})
        return {tab: reply for tab, reply in replies.items() if isinstance(reply, Failure)}

    def screenshot(self, tab: int, box: tuple[float, float, float, float], scale: float) -> bytes | Failure:
        """PNG of a part of a page. The tab is brought to the front meanwhile, since Chrome draws no other."""
        clip = dict(zip(("x", "y", "width", "height"), box, strict=True)) | {"scale": scale}
        params = {"format": "png", "clip": clip, "optimizeForSpeed": True}
        reply = self._call_all({tab: [("Page.bringToFront", {})]})[tab]
        if not isinstance(reply, Failure):
            reply = self._call_all({tab: [("Page.captureScreenshot", params)]})[tab]
        self._hide_tabs()
        if isinstance(reply, Failure):
            return reply
        if not reply.result:
            return Failure(cause="page_error", message=reply.error)
        return base64.b64decode(reply.result["data"])

    def rebuild(self, tab: int) -> set[int]:
        """Replace the renderer process of a tab; returns all tabs that lived in it, which are blank now."""
        index = self._hubs.index(self._hub(tab))
        old = self._hubs[index]
        old.close()
        self._hubs[index] = self._open_hub(list(old.tabs))
        self._hide_tabs()
        return set(old.tabs)

    def has_crashed(self, tab: int) -> bool:
        """Whether the renderer process of this tab is gone."""
        return self._hub(tab).crashed

    def show(self, tab: int) -> None:
        """Bring a tab to the front, where a person can see and use it."""
        self._tools.post(self._tab(tab).session, "Page.bringToFront")

    @property
    def _tools(self) -> DevTools:
        if os.getpid() != self._owner:
            raise RuntimeError(
                f"this Chrome belongs to process {self._owner}: its fork {os.getpid()} must open another"
            )
        if self._devtools is None:
            raise BrowserGone("Chrome is not running")
        return self._devtools

    def _launch_once(self) -> None:
        self.close()
        self._chrome = Chrome(
            headless=self._headless,
            sandbox=self._sandbox,
            timeout_s=self._launch_timeout_s,
            base_url=self._base_url,
        )
        url = browser_url(self._chrome.debugger_address, timeout_s=self._launch_timeout_s)
        self._devtools = DevTools(url, timeout_s=self._launch_timeout_s, on_event=self._on_event)
        hubs = max(min(self._count, PROCESSES), math.ceil(self._count / MAX_TABS_PER_PROCESS))
        self._hubs = [self._open_hub(range(self._count)[first::hubs]) for first in range(hubs)]
        # Chrome's first tab has a renderer process of its own.
        self._devtools.post(BROWSER, "Target.closeTarget", {"targetId": self._chrome.first_target})
        if self._headless:
            self._hide_tabs()
        else:
            self.show(0)

    def _open_hub(self, numbers: Sequence[int]) -> Hub:
        tools = self._tools
        try:
            return Hub(tools, self.chrome.hub_url, numbers, view=self._view, timeout_s=self._launch_timeout_s)
        except (TimeoutError, RuntimeError) as error:
            raise BrowserGone(f"Chrome opens no tab: {error}") from error

    def _hide_tabs(self) -> None:
        """Show a hub's empty page instead: a tab in front draws frames, which costs time."""
        self._tools.post(BROWSER, "Target.activateTarget", {"targetId": self._hubs[0].page.target})

    def _hub(self, tab: int) -> Hub:
        return next(hub for hub in self._hubs if tab in hub.tabs)

    def _tab(self, tab: int) -> Tab:
        return self._hub(tab).tabs[tab]

    def _call_all(
        self, calls: Mapping[int, Sequence[tuple[str, Json]]], *, periods: int = 1
    ) -> dict[int, Reply | Failure]:
        """Make one or more (method, params) calls in each tab, all tabs at the same time.

        Returns the reply to each tab's last call. A tab that has not answered all of them in time gets a Failure, and
        the script that blocks it is interrupted.
        """
        sent = {
            tab: [self._tools.send(self._tab(tab).session, method, params) for method, params in own]
            for tab, own in calls.items()
        }
        every_call = [call for own in sent.values() for call in own]
        replies = self._tools.receive(every_call, timeout_s=self._call_timeout_s, periods=periods)
        outcomes: dict[int, Reply | Failure] = {}
        hung: set[int] = set()
        for tab, own in sent.items():
            if all(call in replies for call in own):
                outcomes[tab] = replies[own[-1]]
            elif self.has_crashed(tab):
                outcomes[tab] = Failure(cause="tab_crashed")
            else:
                outcomes[tab] = Failure.hung(self._call_timeout_s)
                hung.add(tab)
        for hub in self._hubs:
            if hung & hub.tabs.keys():
                hub.interrupt(timeout_s=self._call_timeout_s)
        return outcomes

    def _on_event(self, session: str, method: str, params: Json) -> None:
        if method == "Page.javascriptDialogOpening":
            self._tools.post(session, "Page.handleJavaScriptDialog", {"accept": True})
        elif method in ("Inspector.targetCrashed", "Target.detachedFromTarget"):
            for hub in self._hubs:
                hub.note_crash(params.get("sessionId", session))
