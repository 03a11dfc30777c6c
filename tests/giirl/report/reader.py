"""A Chrome that loads a report and measures it: width, images, headings, console messages and network requests."""

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
CONSOLE_EVENTS = ("Log.entryAdded", "Runtime.consoleAPICalled", "Runtime.exceptionThrown")
MEASURE = """(async () => {
  if (document.readyState !== 'complete') await new Promise((go) => addEventListener('load', go));
  const size = (element) => parseFloat(getComputedStyle(element).fontSize);
  return JSON.stringify({
    scroll_width: document.documentElement.scrollWidth,
    images: document.images.length,
    broken: [...document.images].filter((image) => !image.complete || image.naturalWidth === 0).length,
    without_alt: [...document.images].filter((image) => !image.alt).length,
    scripts: document.scripts.length,
    headings: [...document.querySelectorAll('h1, h2, h3, h4, h5')].map((one) => Number(one.tagName[1])),
    smallest_px: Math.min(...[...document.querySelectorAll('p, td, th, dd, dt, figcaption, summary')].map(size)),
    background: getComputedStyle(document.body).backgroundColor,
    text: document.body.innerText,
  });
})()"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Measurements of a page in a window of a given width."""

    scroll_width: int  # CSS px; more than the window's width means horizontal scrolling
    images: int
    broken: int  # images that did not load
    without_alt: int  # images without an alt text
    scripts: int
    headings: tuple[int, ...]  # their levels, in document order
    smallest_px: float  # smallest font size of text, without SVG
    background: str  # colour of the body
    text: str
    console: tuple[str, ...]  # messages and exceptions
    requests: tuple[str, ...]  # URLs requested, without the page itself and data URLs


class Reader:
    """One tab of a Chrome, which ends with the `with` block."""

    def __init__(self) -> None:
        self._console: list[str] = []
        self._requests: list[str] = []
        self._chrome = Chrome(headless=True, sandbox="auto", timeout_s=60.0)
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
        """Open a file in a window of `width` CSS px and measure it."""
        self._console, self._requests = [], []
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self._call(self._session, "Emulation.setEmulatedMedia", media=media, features=scheme)
        size: Json = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 600}
        self._call(self._session, "Emulation.setDeviceMetricsOverride", **size)
        self._call(self._session, "Page.navigate", url=page.resolve().as_uri())
        answer = self._call(
            self._session, "Runtime.evaluate", expression=MEASURE, awaitPromise=True, returnByValue=True
        )
        found = json.loads(answer["result"]["value"])
        self._tools.pump(time.monotonic() + 0.2)  # the last events may still be in transit
        own = {page.resolve().as_uri()}
        requests = tuple(url for url in self._requests if url not in own and not url.startswith("data:"))
        return Reading(
            **{**found, "headings": tuple(found["headings"])}, console=tuple(self._console), requests=requests
        )

    def _call(self, session: str, method: str, **params: Any) -> Json:
        return self._tools.call(session, method, params, timeout_s=DEADLINE_S)

    def _on_event(self, session: str, method: str, params: Json) -> None:
        if method in CONSOLE_EVENTS:
            self._console.append(json.dumps(params))
        elif method == "Network.requestWillBeSent":
            self._requests.append(params["request"]["url"])
