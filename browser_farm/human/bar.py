"""The bar beside a page that is recorded: a window of its own with the instruction and the person's choices."""

from __future__ import annotations

import json
from contextlib import suppress
from enum import Enum

from browser_farm import pages
from browser_farm.chrome.devtools import BROWSER, DevTools, Json
from browser_farm.sites.browser import FRAME

BINDING = "giirlChoose"  # as in bar.js
HEIGHT = 300  # px, with the tabs and the address of its window


class Choice(Enum):
    """What a person says about an episode; the value is the label of its button."""

    DONE = "Done"
    KEEP = "Keep"
    FAILED = "It failed"
    REDO = "Redo"
    DISCARD = "Discard"


ON_THE_WAY = (Choice.DONE, Choice.FAILED, Choice.REDO, Choice.DISCARD)
AT_THE_END = (Choice.KEEP, Choice.FAILED, Choice.REDO, Choice.DISCARD)


class Bar:
    """The tab `target` of a Chrome, outside every recorded page and its browser context.

    No page can reach it, style it or close it. `choice` is the button that was pressed, until `show` offers others.
    """

    def __init__(self, tools: DevTools, target: str, timeout_s: float) -> None:
        self._tools, self._target, self._timeout_s = tools, target, timeout_s
        self.choice: Choice | None = None
        self.is_closed = False
        self._shown = ""
        self._offered: tuple[Choice, ...] = ()
        self.session = ""
        self.session = str(self._call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"])
        frame = self._call("Page.navigate", {"url": "about:blank"})["frameId"]
        empty = "<!DOCTYPE html><html lang=en><head></head><body></body></html>"
        self._call("Runtime.addBinding", {"name": BINDING})
        self._call("Page.setDocumentContent", {"frameId": frame, "html": empty})
        self._call("Runtime.evaluate", {"expression": pages.source("bar")})

    def show(self, progress: str, instruction: str, note: str, offered: tuple[Choice, ...]) -> None:
        """Show these texts and a button for each choice."""
        if offered != self._offered:
            self.choice, self._offered = None, offered
        buttons = [[choice.name, choice.value] for choice in offered]
        state = json.dumps({"progress": progress, "instruction": instruction, "note": note, "buttons": buttons})
        if state != self._shown:
            self._shown = state
            self._tools.post(self.session, "Runtime.evaluate", {"expression": f"show({state})"})

    def renew(self) -> None:
        """Forget what was pressed: another episode begins."""
        self.choice, self._offered = None, ()

    def place(self, page: str, viewport: tuple[int, int]) -> None:
        """Put the bar above the window of the page with this target, which gets room for the viewport."""
        width, height = viewport[0] + FRAME[0], viewport[1] + FRAME[1]
        for target, top, tall in ((self._target, 0, HEIGHT), (page, HEIGHT, height)):
            with suppress(RuntimeError, TimeoutError):  # a window manager may have its own rules
                window = self._call("Browser.getWindowForTarget", {"targetId": target}, BROWSER)["windowId"]
                bounds = {"left": 0, "top": top, "width": width, "height": tall}
                self._call("Browser.setWindowBounds", {"windowId": window, "bounds": bounds}, BROWSER)

    def _call(self, method: str, params: Json, session: str | None = None) -> Json:
        session = self.session if session is None else session
        return self._tools.call(session, method, params, timeout_s=self._timeout_s)

    def hear(self, session: str, method: str, params: Json) -> None:
        """Take an event of Chrome, if it is one of the bar."""
        if session == BROWSER and method == "Target.detachedFromTarget" and params.get("sessionId") == self.session:
            self.is_closed = True
        elif session == self.session and method == "Runtime.bindingCalled" and params.get("name") == BINDING:
            choice = Choice.__members__.get(str(params["payload"]))
            if choice in self._offered:
                self.choice = choice
