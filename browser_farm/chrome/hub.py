"""One renderer process of Chrome. A hub page in it opens the tabs, so one DevTools call steps all of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from browser_farm import pages
from browser_farm.chrome.answers import Failure, parse_answers, parse_evaluation
from browser_farm.chrome.devtools import BROWSER, DevTools, Json, Reply

WINDOW_OF_ITS_OWN = "popup,width=800,height=600"
Call = tuple[str, str, Json]  # session, method, parameters


@dataclass(frozen=True, slots=True, kw_only=True)
class Tab:
    """One DevTools target and the flat session attached to it."""

    target: str
    session: str


class Hub:
    """Opens its tabs from `url`, a page that may script theirs, so all of them share one process and one thread.

    If one tab crashes, all do. A tab whose script does not return blocks the others until it is interrupted.
    """

    def __init__(
        self, tools: DevTools, url: str, numbers: Sequence[int], *, view: pages.View, timeout_s: float
    ) -> None:
        self._tools = tools
        self._view = view
        self._timeout_s = timeout_s
        self._calls = 0
        self._asked: tuple[int, ...] = ()  # tabs of the last call
        self.crashed = False
        blank = {"url": "about:blank", "background": True}
        (self.page,) = self._attach([self._call(BROWSER, "Target.createTarget", blank)["targetId"]])
        self._call(self.page.session, "Page.navigate", {"url": url})  # returns once the page is loaded
        self._run(pages.source("hub"))
        self.tabs = self._open(numbers)

    def ask(self, requests: Mapping[int, pages.Json]) -> int:
        """Send the requests of these tabs in one call; its id. `answers` reads the reply."""
        self._calls += 1
        self._asked = tuple(requests)
        pairs = json.dumps(list(requests.items()), separators=(",", ":"))
        params = {"expression": f"hub.ask({self._calls},{pairs})", "returnByValue": True}
        return self._tools.send(self.page.session, "Runtime.evaluate", params)

    def answers(self, reply: Reply | None, *, timeout_s: float) -> dict[int, Any | Failure]:
        """What the tabs of the last call answered. `reply` is None if it did not return in time.

        Then the script that runs is interrupted: the tab that blocked the process is `page_hung`, and the tabs that
        waited behind it are missing.
        """
        if self.crashed and reply is None:
            return dict.fromkeys(self._asked, Failure(cause="tab_crashed"))
        if reply is None:
            return self._break_off(timeout_s=timeout_s)
        result = parse_evaluation(reply)
        if isinstance(result, Failure):
            return dict.fromkeys(self._asked, result)
        return parse_answers(json.loads(result))

    def interrupt(self, *, timeout_s: float) -> None:
        """Stop the script that runs in this process; BrowserGone when Chrome as a whole does not answer."""
        self._tools.check_alive(timeout_s=timeout_s / 2)
        self._tools.post(self.page.session, "Runtime.terminateExecution")
        try:
            self._run("0", timeout_s=timeout_s)  # if none was running, Chrome stops the next script: this one
        except (TimeoutError, RuntimeError):
            return

    def note_crash(self, session: str) -> None:
        """If this session is one of the process's, the whole process is gone."""
        sessions = {self.page.session, *(tab.session for tab in self.tabs.values())}
        if session in sessions:
            self.crashed = True
            self._tools.abandon(sessions)

    def close(self) -> None:
        """Close the tabs and the hub page, without waiting for replies."""
        for tab in (*self.tabs.values(), self.page):
            self._tools.post(BROWSER, "Target.closeTarget", {"targetId": tab.target})

    def _break_off(self, *, timeout_s: float) -> dict[int, Any | Failure]:
        """Interrupt the last call and return the answers it has collected, and at least one failure."""
        self.interrupt(timeout_s=timeout_s)
        culprit, answers = None, []
        try:
            status = self._run(f"hub.status({self._calls})", timeout_s=timeout_s)
            if status:
                culprit, answers = json.loads(status)
        except (TimeoutError, RuntimeError, ValueError):
            pass  # the process still does not answer
        hung = Failure.hung(timeout_s)
        if culprit is None:  # none of these tabs: something else in the process never ends
            return dict.fromkeys(self._asked, hung)
        return parse_answers(answers) | {culprit: hung}

    def _open(self, numbers: Sequence[int]) -> dict[int, Tab]:
        # Chrome draws frames only in the front tab of a window, and in real time pages need them.
        features = WINDOW_OF_ITS_OWN if self._view.real_time else ""
        self._run(f"hub.open({json.dumps(list(numbers))},{json.dumps(features)})", gesture=True)
        targets = self._call(BROWSER, "Target.getTargets")["targetInfos"]
        opened = self._attach([info["targetId"] for info in targets if info.get("openerId") == self.page.target])
        names = self._call_all([(tab.session, "Runtime.evaluate", {"expression": "name"}) for tab in opened])
        tabs = {int(reply["result"]["value"]): tab for reply, tab in zip(names, opened, strict=True)}
        if tabs.keys() != set(numbers):
            raise RuntimeError(f"Chrome opened tabs {sorted(tabs)}, wanted {sorted(numbers)}")
        script = ("Page.addScriptToEvaluateOnNewDocument", {"source": self._view.script})
        self._call_all([(tab.session, *call) for tab in opened for call in (script, *self._view.emulation)])
        return tabs

    def _attach(self, targets: Sequence[str]) -> list[Tab]:
        attach = [(BROWSER, "Target.attachToTarget", {"targetId": target, "flatten": True}) for target in targets]
        sessions = [str(reply["sessionId"]) for reply in self._call_all(attach)]
        enable = ("Page.enable", "Inspector.enable")
        self._call_all([(session, method, {}) for session in sessions for method in enable])
        return [Tab(target=target, session=session) for target, session in zip(targets, sessions, strict=True)]

    def _run(self, expression: str, *, timeout_s: float | None = None, gesture: bool = False) -> str:
        params = {"expression": expression, "returnByValue": True, "userGesture": gesture}
        result = self._call(self.page.session, "Runtime.evaluate", params, timeout_s=timeout_s)
        return str(result["result"].get("value", ""))

    def _call_all(self, calls: Sequence[Call]) -> list[Json]:
        """Make many calls at once and return their results in the same order."""
        sent = [self._tools.send(*call) for call in calls]
        replies = self._tools.receive(sent, timeout_s=self._timeout_s)
        for (_, method, _), call in zip(calls, sent, strict=True):
            if call not in replies:
                raise TimeoutError(f"Chrome did not answer {method} in {self._timeout_s:g} s")
            if replies[call].error:
                raise RuntimeError(f"Chrome refused {method}: {replies[call].error}")
        return [replies[call].result for call in sent]

    def _call(self, session: str, method: str, params: Json | None = None, *, timeout_s: float | None = None) -> Json:
        return self._tools.call(session, method, params, timeout_s=timeout_s or self._timeout_s)
