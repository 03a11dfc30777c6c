"""One renderer process of Chrome: a page that speaks for the tabs it opened, so that one call steps them all."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

from browser_farm import pages
from browser_farm.chrome.devtools import BROWSER, DevTools, Json

NUMBERS = count(1)
Call = tuple[str, str, Json]  # session, method, parameters


@dataclass(slots=True, kw_only=True)
class Tab:
    """One target of Chrome and the flat session that speaks to it."""

    target: str
    session: str
    crashed: bool = False


class Hub:
    """Opens its tabs in `url`, a page of the same origin as theirs; they share one process and one thread.

    A crash takes all of them; a page that does not come back holds up the others until it is interrupted.
    """

    def __init__(
        self, tools: DevTools, url: str, numbers: Sequence[int], *, view: pages.View, timeout_s: float
    ) -> None:
        self._tools = tools
        self._view = view
        self._timeout_s = timeout_s
        blank = {"url": "about:blank", "background": True}
        (self.page,) = self._attach([self._call(BROWSER, "Target.createTarget", blank)["targetId"]])
        self._call(self.page.session, "Page.navigate", {"url": url})  # answers when the page is there
        self._run(pages.source("hub"))
        self.tabs = self._open(numbers)

    @property
    def crashed(self) -> bool:
        return self.page.crashed or any(tab.crashed for tab in self.tabs.values())

    def ask(self, questions: Mapping[int, pages.Json]) -> tuple[int, int]:
        """Start one call that asks these tabs; the number of the call, and that of its message."""
        number = next(NUMBERS)
        words = json.dumps(list(questions.items()), separators=(",", ":"))
        expression = f"hub.ask({number},{words})"
        return number, self._tools.send(
            self.page.session, "Runtime.evaluate", {"expression": expression, "returnByValue": True}
        )

    def break_off(self, number: int, *, timeout_s: float) -> tuple[int | None, dict[int, Any]]:
        """Interrupt a call that does not end: which tab it was at, None if at none, and what the others said."""
        self.interrupt(timeout_s=timeout_s)
        try:
            told = self._run(f"hub.told({number})", timeout_s=timeout_s)
            asked, said = json.loads(told) if told else (None, [])
        except (TimeoutError, RuntimeError, ValueError):
            return None, {}
        return asked, dict(said)

    def interrupt(self, *, timeout_s: float) -> None:
        """Stop whatever script runs in this process."""
        self._tools.post(self.page.session, "Runtime.terminateExecution")
        try:
            self._run("0", timeout_s=timeout_s)  # where none ran, it is the next one that is stopped
        except (TimeoutError, RuntimeError):
            return

    def close(self) -> None:
        """Close the tabs and the page; no answer is waited for."""
        for tab in (*self.tabs.values(), self.page):
            self._tools.post(BROWSER, "Target.closeTarget", {"targetId": tab.target})

    def _open(self, numbers: Sequence[int]) -> dict[int, Tab]:
        self._run(f"hub.open({json.dumps(list(numbers))})", gesture=True)
        targets = self._call(BROWSER, "Target.getTargets")["targetInfos"]
        opened = self._attach([info["targetId"] for info in targets if info.get("openerId") == self.page.target])
        named = self._call_all([(tab.session, "Runtime.evaluate", {"expression": "name"}) for tab in opened])
        tabs = {int(reply["result"]["value"]): tab for reply, tab in zip(named, opened, strict=True)}
        if tabs.keys() != set(numbers):
            raise RuntimeError(f"tabs {sorted(tabs)} opened, wanted {sorted(numbers)}")
        source = ("Page.addScriptToEvaluateOnNewDocument", {"source": self._view.script})
        self._call_all([(tab.session, *how) for tab in opened for how in (source, *self._view.emulation)])
        return tabs

    def _attach(self, targets: Sequence[str]) -> list[Tab]:
        told: list[Call] = [
            (BROWSER, "Target.attachToTarget", {"targetId": target, "flatten": True}) for target in targets
        ]
        sessions = [str(reply["sessionId"]) for reply in self._call_all(told)]
        self._call_all([(session, how, {}) for session in sessions for how in ("Page.enable", "Inspector.enable")])
        return [Tab(target=target, session=session) for target, session in zip(targets, sessions, strict=True)]

    def _run(self, expression: str, *, timeout_s: float | None = None, gesture: bool = False) -> str:
        params = {"expression": expression, "returnByValue": True, "userGesture": gesture}
        result = self._call(self.page.session, "Runtime.evaluate", params, timeout_s=timeout_s)
        return str(result["result"].get("value", ""))

    def _call_all(self, calls: Sequence[Call]) -> list[Json]:
        """Many calls at once, and their results in this order."""
        started = [self._tools.send(*call) for call in calls]
        replies = self._tools.receive(started, deadline=time.monotonic() + self._timeout_s, given_up=set)
        for (_, method, _), call in zip(calls, started, strict=True):
            if call not in replies:
                raise TimeoutError(f"Chrome did not answer {method} in {self._timeout_s:g} s")
            if replies[call].error:
                raise RuntimeError(f"Chrome refused {method}: {replies[call].error}")
        return [replies[call].result for call in started]

    def _call(self, session: str, method: str, params: Json | None = None, *, timeout_s: float | None = None) -> Json:
        return self._tools.call(session, method, params, timeout_s=timeout_s or self._timeout_s)
