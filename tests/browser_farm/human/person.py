"""A simulated person at the two windows of a recording, in a thread and with a DevTools connection of their own."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from typing import Any

from browser_farm.chrome.devtools import BROWSER, BrowserGone, DevTools, Json, browser_url
from browser_farm.human.site_recorder import SiteRecorder
from giirl_core.types import Episode, EpisodeSpec
from tests.browser_farm.hand import Hand

DEADLINE_S = 20.0
PAUSE_S = 0.02


class Person(Hand):
    """Sends trusted input to the page, and presses buttons of the bar. Every wait has a deadline."""

    def __init__(self, recorder: SiteRecorder) -> None:
        chrome = recorder._browser.chrome
        self.dialogs: list[Json] = []
        self.tools = DevTools(browser_url(chrome.debugger_address, timeout_s=5.0), timeout_s=5.0, on_event=self._hear)
        self._bar_target = chrome.first_target
        self._bar = self._attach(chrome.first_target)
        self._page, self._page_target = "", ""
        self._recorder = recorder

    def look_at_page(self) -> None:
        """Turn to the next page, and wait until it is open."""
        old, found = self._page_target, [self._page_target]

        def is_there() -> bool:
            found[:] = [page for page in self._pages() if page != old]
            return bool(found)

        self.wait(is_there, "a page")
        self._page_target = found[0]
        self._page = self._attach(self._page_target)
        self.tools.call(self._page, "Page.enable", timeout_s=5.0)
        self.read("actions so far")

    def bar(self) -> str:
        """All text of the bar."""
        return self._evaluate(self._bar, "document.body.innerText")

    def ask_bar(self, expression: str) -> str:
        return self._evaluate(self._bar, expression)

    def read(self, text: str) -> None:
        """Wait until the bar shows this text."""
        self.wait(lambda: text in self.bar(), f"{text!r} in the bar")

    def see(self, selector: str) -> None:
        """Wait until the page has such an element."""
        found = f"String(document.querySelector({json.dumps(selector)}) !== null)"
        self.wait(lambda: self.ask(found) == "true", selector)

    def look_around(self, text: str) -> None:
        """Wait until the page is quiet, as a person does before acting: until the recorder has seen this text on it."""

        def seen() -> bool:
            quiet = self._recorder._steps._quiet
            return quiet is not None and text in quiet.text

        self.wait(seen, f"a quiet page with {text!r}")

    def choose(self, label: str) -> None:
        """Press a button of the bar."""
        self.read(label)
        place = f"""JSON.stringify((() => {{ const box = [...document.querySelectorAll('button')]
          .find((one) => one.textContent === {json.dumps(label)}).getBoundingClientRect();
          return [box.left + box.width / 2, box.top + box.height / 2]; }})())"""
        page, self._page = self._page, self._bar
        self.click_at(*json.loads(self.ask_bar(place)))
        self._page = page

    def answer(self, *, accept: bool, text: str = "") -> None:
        """Answer the dialog that the page shows."""
        self.wait(lambda: bool(self.dialogs), "a dialog")
        self.dialogs.clear()
        params = {"accept": accept, "promptText": text}
        self.tools.call(self._page, "Page.handleJavaScriptDialog", params, timeout_s=5.0)

    def close_window(self, *, of_bar: bool = False) -> None:
        target = self._bar_target if of_bar else self._page_target
        self.tools.call(BROWSER, "Target.closeTarget", {"targetId": target}, timeout_s=5.0)

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, f"waited {DEADLINE_S:g} s for {what}; the bar says {self.bar()!r}"
            self.tools.pump(time.monotonic() + PAUSE_S)

    def ask(self, expression: str) -> str:
        return self._evaluate(self._page, expression)

    def _send(self, method: str, **params: Any) -> None:
        """Send input until Chrome has dispatched it, or a dialog has opened."""
        call = self.tools.send(self._page, method, params)
        self.wait(lambda: self.tools.has_reply(call) or bool(self.dialogs), method)
        self.tools.take(call)

    def _evaluate(self, session: str, expression: str) -> str:
        params = {"expression": expression, "returnByValue": True}
        for _ in range(50):  # a document that is being replaced does not answer
            try:
                value = self.tools.call(session, "Runtime.evaluate", params, timeout_s=5.0)["result"].get("value", "")
                return str(value)
            except RuntimeError:
                time.sleep(PAUSE_S)
        raise AssertionError(f"{expression} has no value")

    def _attach(self, target: str) -> str:
        params = {"targetId": target, "flatten": True}
        return str(self.tools.call(BROWSER, "Target.attachToTarget", params, timeout_s=5.0)["sessionId"])

    def _pages(self) -> list[str]:
        infos = self.tools.call(BROWSER, "Target.getTargets", timeout_s=5.0)["targetInfos"]
        return [i["targetId"] for i in infos if i["type"] == "page" and i["targetId"] != self._bar_target]

    def _hear(self, session: str, method: str, params: Json) -> None:
        if method == "Page.javascriptDialogOpening":
            self.dialogs.append(params)


def record(recorder: SiteRecorder, spec: EpisodeSpec, act: Callable[[Person], None], note: str = "") -> Episode | None:
    """The episode that the recorder makes of what a person does. A person who fails closes the window."""
    failures: list[BaseException] = []

    def run() -> None:
        person = Person(recorder)
        try:
            person.look_at_page()
            act(person)
        except BaseException as error:  # noqa: BLE001 - it is raised again in the test's own thread
            failures.append(error)
            person.close_window(of_bar=not person._page_target)
        finally:
            person.tools.close()

    thread = threading.Thread(target=run)
    started: list[str] = []

    def begin(goal: str) -> None:
        if not started:
            thread.start()
        started.append(goal)

    try:
        return recorder.record(spec, begin, "0 of 1 recorded", note)
    except BrowserGone:
        if failures:
            raise failures[0] from None
        raise
    finally:
        thread.join(DEADLINE_S)
        if failures:
            raise failures[0]
