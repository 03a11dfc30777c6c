"""A Chrome in which a test reads a page as a person would: how wide it gets, what is missing, what it complains of."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from browser_farm.chrome.devtools import BROWSER, DevTools, Json, browser_url
from browser_farm.chrome.launcher import Chrome

DEADLINE_S = 30.0
COMPLAINTS = ("Log.entryAdded", "Runtime.consoleAPICalled", "Runtime.exceptionThrown")
LOOK = """(async () => {
  if (document.readyState !== 'complete') await new Promise((go) => addEventListener('load', go));
  const size = (element) => parseFloat(getComputedStyle(element).fontSize);
  return JSON.stringify({
    scroll_width: document.documentElement.scrollWidth,
    images: document.images.length,
    broken: [...document.images].filter((image) => !image.complete || image.naturalWidth === 0).length,
    nameless: [...document.images].filter((image) => !image.alt).length,
    scripts: document.scripts.length,
    headings: [...document.querySelectorAll('h1, h2, h3, h4, h5')].map((one) => Number(one.tagName[1])),
    smallest_px: Math.min(...[...document.querySelectorAll('p, td, th, dd, dt, figcaption, summary')].map(size)),
    paper: getComputedStyle(document.body).backgroundColor,
    text: document.body.innerText,
  });
})()"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What a page came to in a window of some width."""

    scroll_width: int  # CSS px; more than the window's width means scrolling sideways
    images: int
    broken: int  # images that did not load
    nameless: int  # images without a text for those who see none
    scripts: int
    headings: tuple[int, ...]  # their levels, in order
    smallest_px: float  # of ordinary text
    paper: str  # the colour behind everything
    text: str
    complaints: tuple[str, ...]  # what stands on the console
    addresses: tuple[str, ...]  # what was asked of anybody but the page itself


class Reader:
    """One tab. Leaving the `with` block ends its Chrome."""

    def __init__(self) -> None:
        self._complaints: list[str] = []
        self._addresses: list[str] = []
        self._chrome = Chrome(headless=True, no_sandbox=None, timeout_s=60.0)
        try:
            url = browser_url(self._chrome.debugger_address, timeout_s=DEADLINE_S)
            self._tools = DevTools(url, timeout_s=DEADLINE_S, on_event=self._on_event)
            target = self._call(BROWSER, "Target.createTarget", url="about:blank")["targetId"]
            self._session = self._call(BROWSER, "Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
            for domain in ("Page", "Runtime", "Log", "Network"):
                self._call(self._session, f"{domain}.enable")
        except BaseException:
            self._chrome.end()
            raise

    def __enter__(self) -> Reader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._tools.close()
        self._chrome.end()

    def read(self, page: Path, *, width: int, dark: bool = False, media: str = "screen") -> Reading:
        """Open a file in a window so many CSS px wide."""
        self._complaints, self._addresses = [], []
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self._call(self._session, "Emulation.setEmulatedMedia", media=media, features=scheme)
        size: Json = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 600}
        self._call(self._session, "Emulation.setDeviceMetricsOverride", **size)
        self._call(self._session, "Page.navigate", url=page.resolve().as_uri())
        seen = self._call(self._session, "Runtime.evaluate", expression=LOOK, awaitPromise=True, returnByValue=True)
        found = json.loads(seen["result"]["value"])
        self._tools.pump(time.monotonic() + 0.2)  # what was said last may still be on its way
        own = {page.resolve().as_uri()}
        asked = tuple(a for a in self._addresses if a not in own and not a.startswith("data:"))
        return Reading(
            **{**found, "headings": tuple(found["headings"])}, complaints=tuple(self._complaints), addresses=asked
        )

    def _call(self, session: str, method: str, **params: Any) -> Json:
        return self._tools.call(session, method, params, timeout_s=DEADLINE_S)

    def _on_event(self, session: str, method: str, params: Json) -> None:
        if method in COMPLAINTS:
            self._complaints.append(json.dumps(params))
        elif method == "Network.requestWillBeSent":
            self._addresses.append(params["request"]["url"])
