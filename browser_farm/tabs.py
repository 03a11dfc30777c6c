"""K tabs of one Chrome: evaluates in many at once, navigates many at once, and says what went wrong."""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping
from dataclasses import dataclass

import tenacity

from browser_farm.chrome import Chrome, LaunchFailed
from browser_farm.devtools import BROWSER, BrowserGone, DevTools, Json, Reply, browser_url

LAUNCH_ATTEMPTS = 3
LONGEST_BACK_OFF_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Failure:
    """Why a tab gave no value: `page_hung`, `tab_crashed`, `navigated` or `page_error`, and in words."""

    cause: str
    words: str = ""


@dataclass(slots=True, kw_only=True)
class Tab:
    """One target of Chrome and the flat session that speaks to it."""

    target: str
    session: str
    crashed: bool = False


class Tabs:
    """Its methods raise BrowserGone once Chrome is dead or silent; `launch` starts another."""

    def __init__(
        self,
        count: int,
        *,
        script: str,
        emulation: tuple[tuple[str, Json], ...],
        call_timeout_s: float,
        launch_timeout_s: float,
        headless: bool,
        no_sandbox: bool | None,
    ) -> None:
        self._count = count
        self._script = script
        self._emulation = emulation
        self._call_timeout_s = call_timeout_s
        self._launch_timeout_s = launch_timeout_s
        self._headless = headless
        self._no_sandbox = no_sandbox
        self._chrome: Chrome | None = None
        self._devtools: DevTools | None = None
        self._tabs: list[Tab] = []
        self._by_session: dict[str, Tab] = {}

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
        self._tabs.clear()
        self._by_session.clear()

    def evaluate(self, expressions: Mapping[int, str], *, promised: bool = False) -> dict[int, str | Failure]:
        """Run one expression in each tab, all at the same time; each gives a string, or promises one."""
        params = {
            tab: {"expression": expression, "returnByValue": True, "awaitPromise": promised}
            for tab, expression in expressions.items()
        }
        replies = self._call_all("Runtime.evaluate", params)
        return {tab: reply if isinstance(reply, Failure) else _evaluated(reply) for tab, reply in replies.items()}

    def navigate(self, urls: Mapping[int, str]) -> dict[int, Failure]:
        """Show a url in each tab, all at the same time; only those that failed are in the answer."""
        for tab in urls:
            self._tabs[tab].crashed = False  # navigating brings a crashed tab back
        replies = self._call_all("Page.navigate", {tab: {"url": url} for tab, url in urls.items()})
        failures: dict[int, Failure] = {}
        for tab, reply in replies.items():
            if isinstance(reply, Failure):
                failures[tab] = reply
            elif reply.error or reply.result.get("errorText"):
                words = reply.error or str(reply.result["errorText"])
                failures[tab] = Failure(cause="navigated", words=words)
        return failures

    def screenshot(self, tab: int, width: int, height: int) -> bytes | Failure:
        """The upper left corner of a page as PNG. The tab is brought to the front: Chrome draws no other."""
        clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
        shot = {"format": "png", "clip": clip, "optimizeForSpeed": True}
        reply = self._call_all("Page.bringToFront", {tab: {}})[tab]
        if not isinstance(reply, Failure):
            reply = self._call_all("Page.captureScreenshot", {tab: shot})[tab]
        if isinstance(reply, Failure):
            return reply
        return (
            base64.b64decode(reply.result["data"]) if reply.result else Failure(cause="page_error", words=reply.error)
        )

    def interrupt(self, tab: int) -> None:
        """Stop the script that runs in a tab."""
        self._tools.post(self._tabs[tab].session, "Runtime.terminateExecution")

    def replace(self, tab: int) -> None:
        """Give up a tab that does not come back, and open another in its place."""
        old = self._tabs[tab]
        self._by_session.pop(old.session, None)
        self._tools.post(BROWSER, "Target.closeTarget", {"targetId": old.target})
        self._tabs[tab] = self._open_tab()

    @property
    def _tools(self) -> DevTools:
        if self._devtools is None:
            raise BrowserGone("Chrome is not running")
        return self._devtools

    def _launch_once(self) -> None:
        self.close()
        self._chrome = Chrome(headless=self._headless, no_sandbox=self._no_sandbox, timeout_s=self._launch_timeout_s)
        url = browser_url(self._chrome.debugger_address, timeout_s=self._call_timeout_s)
        self._devtools = DevTools(url, timeout_s=self._call_timeout_s, on_event=self._on_event)
        self._tabs = [self._open_tab() for _ in range(self._count)]

    def _open_tab(self) -> Tab:
        timeout_s = self._launch_timeout_s
        tools = self._tools
        try:
            target = tools.call(
                BROWSER,
                "Target.createTarget",
                {"url": "about:blank", "background": True},
                timeout_s=timeout_s,
            )["targetId"]
            session = tools.call(
                BROWSER, "Target.attachToTarget", {"targetId": target, "flatten": True}, timeout_s=timeout_s
            )["sessionId"]
            tab = Tab(target=target, session=session)
            self._by_session[session] = tab
            tools.call(session, "Page.enable", timeout_s=timeout_s)
            tools.call(session, "Inspector.enable", timeout_s=timeout_s)
            for method, params in self._emulation:
                tools.call(session, method, params, timeout_s=timeout_s)
            source = {"source": self._script}
            tools.call(session, "Page.addScriptToEvaluateOnNewDocument", source, timeout_s=timeout_s)
        except (TimeoutError, RuntimeError) as error:
            raise BrowserGone(f"Chrome opens no tab: {error}") from error
        return tab

    def _call_all(self, method: str, params: Mapping[int, Json]) -> dict[int, Reply | Failure]:
        deadline = time.monotonic() + self._call_timeout_s
        tools = self._tools
        calls = {tab: tools.send(self._tabs[tab].session, method, each) for tab, each in params.items()}

        def given_up() -> set[int]:
            return {call for tab, call in calls.items() if self._tabs[tab].crashed}

        replies = tools.receive(calls.values(), deadline=deadline, given_up=given_up)
        answers: dict[int, Reply | Failure] = {}
        for tab, call in calls.items():
            if call in replies:
                answers[tab] = replies[call]
            elif self._tabs[tab].crashed:
                answers[tab] = Failure(cause="tab_crashed")
            else:
                answers[tab] = Failure(cause="page_hung", words=f"no answer in {self._call_timeout_s:g} s")
        if any(isinstance(answer, Failure) and answer.cause == "page_hung" for answer in answers.values()):
            self._check_alive()
        return answers

    def _check_alive(self) -> None:
        try:
            self._tools.call(BROWSER, "Browser.getVersion", timeout_s=self._call_timeout_s)
        except TimeoutError as error:
            raise BrowserGone(str(error)) from error

    def _on_event(self, session: str, method: str, params: Json) -> None:
        if method == "Page.javascriptDialogOpening":
            self._tools.post(session, "Page.handleJavaScriptDialog", {"accept": True})
        elif method == "Inspector.targetCrashed" and session in self._by_session:
            self._by_session[session].crashed = True
        elif method == "Target.detachedFromTarget" and params.get("sessionId") in self._by_session:
            self._by_session[params["sessionId"]].crashed = True


def _evaluated(reply: Reply) -> str | Failure:
    if reply.error:  # the document went away while it was asked
        return Failure(cause="navigated", words=reply.error)
    details = reply.result.get("exceptionDetails")
    if details is not None:
        words = details.get("exception", {}).get("description", details.get("text", ""))
        return Failure(cause="page_error", words=str(words).splitlines()[0] if words else "")
    return str(reply.result["result"].get("value", ""))
