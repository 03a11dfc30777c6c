"""One page in a browser context of its own: its DevTools session, what is under way in it, and when it is quiet."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from browser_farm import pages
from browser_farm.chrome.devtools import BROWSER, DevTools, Json
from browser_farm.sites.origins import origin_of, proxy_bypass
from browser_farm.sites.page import Dialog
from browser_farm.sites.routines import Routine, ScriptThrew, TabFailed, Wait
from browser_farm.sites.traffic import Traffic

WORLD = "giirl"  # the world in which our scripts run
UNCOUNTED = frozenset(
    {"WebSocket", "EventSource", "Ping", "CSPViolationReport", "Preflight"}
)  # never end, or no matter
DOCUMENTS: Json = {"patterns": [{"resourceType": "Document"}]}
SCRIPTS = ("attributes", "site_reading", "site")


class Session:
    """A page and its browser context; `close` ends both. Its methods are routines that fail with TabFailed.

    `hear` takes the events of Chrome. `script` runs beside ours, in the same world. `frame` is what the window has
    beside the page, px. `refused` counts documents of origins that are not allowed.
    """

    def __init__(
        self,
        tools: DevTools,
        *,
        proxy: str,
        origins: frozenset[str],
        viewport: tuple[int, int],
        timeout_s: float,
        on_refused: Callable[[str], None],
        script: str = "",
        frame: tuple[int, int] = (0, 0),
    ) -> None:
        self._tools, self._timeout_s, self._viewport = tools, timeout_s, viewport
        self._origins, self._on_refused = origins, on_refused
        self._proxy, self._script, self._frame = proxy, script, frame
        self.context = self.target = self.id = ""
        self.dialog: Dialog | None = None
        self.crashed = False
        self.file_chooser = False  # the page has asked for a file
        self.address = "about:blank"
        self.status = 0  # HTTP status of the main document
        self.refused: list[str] = []  # addresses of documents that were not loaded
        self._world: int | None = None
        self.traffic = Traffic()
        self.is_broken = False  # the page's server did not answer

    # ---- life

    def open(self, setup: Sequence[tuple[str, Json]] = ()) -> Routine[None]:
        """Create the context and an empty page with our scripts; `setup` are further calls in the page."""
        rules = proxy_bypass(sorted(self._origins))
        context = {"disposeOnDetach": True, "proxyServer": self._proxy, "proxyBypassList": rules}
        self.context = str((yield from self._browser("Target.createBrowserContext", context))["browserContextId"])
        width, height = self._viewport
        window = {"width": width + self._frame[0], "height": height + self._frame[1]}
        page = {"url": "about:blank", "browserContextId": self.context, **window}
        self.target = str((yield from self._browser("Target.createTarget", page))["targetId"])
        attach = {"targetId": self.target, "flatten": True}
        self.id = str((yield from self._browser("Target.attachToTarget", attach))["sessionId"])
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        parts = ["(() => {", "if ('giirl' in window) return;", *map(pages.source, SCRIPTS), self._script, "})();"]
        calls: list[tuple[str, Json]] = [
            ("Page.enable", {}),
            ("Inspector.enable", {}),
            ("Network.enable", {}),
            ("Fetch.enable", DOCUMENTS),
            ("Page.setInterceptFileChooserDialog", {"enabled": True}),
            ("Emulation.setDeviceMetricsOverride", size),
            ("Emulation.setFocusEmulationEnabled", {"enabled": True}),
            ("Page.addScriptToEvaluateOnNewDocument", {"source": "\n".join(parts), "worldName": WORLD}),
            ("Page.addScriptToEvaluateOnNewDocument", {"source": pages.source("site_window")}),
            *setup,
        ]
        yield from self._browser("Browser.setDownloadBehavior", {"behavior": "deny", "browserContextId": self.context})
        sent = [(self._tools.send(self.id, method, params), method) for method, params in calls]
        for call, method in sent:
            yield from self._needed(call, method)

    def close(self) -> None:
        """End the context with its page, without waiting."""
        if self.id:
            self._tools.post(self.id, "Runtime.terminateExecution")  # a page that loops would delay its end
        if self.context:
            self._tools.post(BROWSER, "Target.disposeBrowserContext", {"browserContextId": self.context})

    def navigate(self, address: str, timeout_s: float) -> Routine[None]:
        """Load an address until the server has begun to answer."""
        call = self._tools.send(self.id, "Page.navigate", {"url": address})
        yield Wait(lambda: self._tools.has_reply(call) or self.dialog is not None, time.monotonic() + timeout_s)
        reply = self._tools.take(call)
        if reply is None and self.dialog is None:
            raise TabFailed("unreachable", f"{address} did not answer in {timeout_s:g} s")
        failed = str(reply.result.get("errorText", reply.error)) if reply is not None else ""
        if failed and self.refused:
            raise TabFailed("refused", f"{address} leads to {self.refused[-1]}, whose origin is not among the allowed")
        if failed:
            raise TabFailed("unreachable", f"{address} cannot be opened: {failed.removeprefix('net::')}")

    # ---- events

    def hear(self, session: str, method: str, params: Json) -> None:
        """Take an event of Chrome, if it is one of this session."""
        if session == BROWSER and method == "Target.detachedFromTarget" and params.get("sessionId") == self.id:
            self.crashed = True
        elif session and session == self.id and method in _HANDLERS:
            _HANDLERS[method](self, params)

    def _request_begins(self, params: Json) -> None:
        self.traffic.begins(params)

    def _request_ends(self, params: Json) -> None:
        self.traffic.ends(params)

    def _responds(self, params: Json) -> None:
        if params.get("type") == "Document" and params.get("frameId") == self.target:
            self.status = int(params["response"]["status"])

    def _navigated(self, params: Json) -> None:
        frame = params["frame"]
        if frame.get("parentId"):
            return
        self.address = str(frame.get("unreachableUrl") or frame["url"])
        self.is_broken = "unreachableUrl" in frame
        self._world = None
        self.traffic.keep_only(str(frame["loaderId"]))

    def _navigated_within(self, params: Json) -> None:
        if params["frameId"] == self.target:
            self.address = str(params["url"])
            self.traffic.touch()

    def _dialog_opens(self, params: Json) -> None:
        kind = str(params["type"])
        if kind == "beforeunload":
            self._tools.post(self.id, "Page.handleJavaScriptDialog", {"accept": True})
        else:
            self.dialog = Dialog(kind, " ".join(str(params["message"]).split()), str(params.get("defaultPrompt", "")))

    def _dialog_closes(self, params: Json) -> None:
        self.dialog = None

    def _file_is_asked_for(self, params: Json) -> None:
        self.file_chooser = True

    def _document_is_asked_for(self, params: Json) -> None:
        """A document, of the page or of a frame, is loaded only from an allowed origin; else all stays as it is."""
        address, request = str(params["request"]["url"]), {"requestId": params["requestId"]}
        if not address.startswith("http") or origin_of(address) in self._origins:
            self._tools.post(self.id, "Fetch.continueRequest", request)
        else:
            self.refused.append(address)
            self._on_refused(address)
            self._tools.post(self.id, "Fetch.failRequest", {**request, "errorReason": "Aborted"})

    def _crashes(self, params: Json) -> None:
        self.crashed = True

    # ---- calls

    def call(self, method: str, params: Mapping[str, Any] | None = None) -> Routine[Json]:
        """The result of a call to the page; {} if a dialog has opened instead, or its document has gone."""
        call = self._tools.send(self.id, method, params)

        def ready() -> bool:
            return self._tools.has_reply(call) or self.crashed or self.dialog is not None

        yield Wait(ready, time.monotonic() + self._timeout_s)
        reply = self._tools.take(call)
        if reply is not None:
            return {} if reply.error else reply.result
        if self.crashed:
            raise TabFailed("tab_crashed")
        if self.dialog is not None:
            return {}
        raise self._hung()

    def send_input(self, events: Sequence[tuple[str, Json]]) -> Routine[None]:
        """Send input events and wait until Chrome has dispatched them, or a dialog has opened, or the page has gone."""
        calls = [self._tools.send(self.id, method, params) for method, params in events]
        begun_s, address = self.traffic.active_s, self.address

        def done() -> bool:
            return self.crashed or self.dialog is not None or all(map(self._tools.has_reply, calls))

        is_done = yield Wait(done, time.monotonic() + self._timeout_s)
        for call in calls:
            self._tools.take(call)
        if self.crashed:
            raise TabFailed("tab_crashed")
        if not is_done and (begun_s, address) == (self.traffic.active_s, self.address):
            raise self._hung()

    def answer(self, *, accept: bool, text: str) -> Routine[None]:
        """Answer the open dialog and wait until it is closed."""
        dialog = self.dialog
        self._tools.post(self.id, "Page.handleJavaScriptDialog", {"accept": accept, "promptText": text})
        closed = yield Wait(lambda: self.crashed or self.dialog is not dialog, time.monotonic() + self._timeout_s)
        if not closed:
            raise self._hung()

    def evaluate(self, expression: str, *, in_page: bool = False) -> Routine[Any]:
        """The value of an expression in our world, or in the page's; None if a dialog or navigation came between."""
        params: Json = {"expression": expression, "returnByValue": True, "awaitPromise": in_page}
        if not in_page:
            if self._world is None:
                world = yield from self.call("Page.createIsolatedWorld", {"frameId": self.target, "worldName": WORLD})
                self._world = world.get("executionContextId")
            if self._world is None:
                return None
            params["contextId"] = self._world
        result = yield from self.call("Runtime.evaluate", params)
        if not result:
            self._world = None
            return None
        if "exceptionDetails" in result:
            details = result["exceptionDetails"]
            message = str(details.get("exception", {}).get("description", details.get("text", "")))
            failed = ScriptThrew if in_page else TabFailed
            raise failed("page_error", f"{expression[:80]}: {message.splitlines()[0] if message else ''}")
        return result["result"].get("value")

    def _browser(self, method: str, params: Mapping[str, Any]) -> Routine[Json]:
        return (yield from self._needed(self._tools.send(BROWSER, method, params), method))

    def _needed(self, call: int, method: str) -> Routine[Json]:
        """The result of a call that Chrome may not refuse."""
        yield Wait(lambda: self._tools.has_reply(call) or self.crashed, time.monotonic() + self._timeout_s)
        reply = self._tools.take(call)
        if reply is None:
            raise TabFailed("tab_crashed") if self.crashed else self._hung()
        if reply.error:
            raise TabFailed("page_error", f"Chrome refused {method}: {reply.error}")
        return reply.result

    def _hung(self) -> TabFailed:
        if self.id:
            self._tools.post(self.id, "Runtime.terminateExecution")
        return TabFailed("page_hung", f"no answer in {self._timeout_s:g} s")


_HANDLERS: dict[str, Callable[[Session, Json], None]] = {
    "Network.requestWillBeSent": Session._request_begins,
    "Network.responseReceived": Session._responds,
    "Network.loadingFinished": Session._request_ends,
    "Network.loadingFailed": Session._request_ends,
    "Page.frameNavigated": Session._navigated,
    "Page.navigatedWithinDocument": Session._navigated_within,
    "Page.javascriptDialogOpening": Session._dialog_opens,
    "Page.javascriptDialogClosed": Session._dialog_closes,
    "Page.fileChooserOpened": Session._file_is_asked_for,
    "Fetch.requestPaused": Session._document_is_asked_for,
    "Inspector.targetCrashed": Session._crashes,
}
