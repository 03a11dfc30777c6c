"""The requests of a page that are under way."""

from __future__ import annotations

import fnmatch
import time
from collections.abc import Sequence

from browser_farm.chrome.devtools import Json

UNCOUNTED = frozenset(
    {"WebSocket", "EventSource", "Ping", "CSPViolationReport", "Preflight"}
)  # never end, or no matter


class Traffic:
    """Follows the Network events of one page. `active_s` is when a request began or ended last (`time.monotonic`)."""

    def __init__(self) -> None:
        self.active_s = time.monotonic()
        self._requests: dict[str, tuple[str, str]] = {}  # id -> loader, address

    def touch(self) -> None:
        """Note that something has happened."""
        self.active_s = time.monotonic()

    def begins(self, params: Json) -> None:
        """Network.requestWillBeSent"""
        self.touch()
        address = str(params["request"]["url"])
        if params.get("type") not in UNCOUNTED and address.startswith("http"):
            self._requests[params["requestId"]] = (str(params.get("loaderId", "")), address)

    def ends(self, params: Json) -> None:
        """Network.loadingFinished, Network.loadingFailed"""
        if self._requests.pop(params["requestId"], None) is not None:
            self.touch()

    def keep_only(self, loader: str) -> None:
        """Another document has replaced that of all other loaders: nobody reads what they asked for."""
        self.touch()
        self._requests = {key: (own, address) for key, (own, address) in self._requests.items() if own == loader}

    def under_way(self, ignored: Sequence[str]) -> list[str]:
        """The addresses of the requests that have not ended, without those that match an ignored pattern."""
        return [
            address
            for _, address in self._requests.values()
            if not any(fnmatch.fnmatchcase(address, pattern) for pattern in ignored)
        ]
