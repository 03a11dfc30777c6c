"""One Chrome for task files: with the proxy that refuses, the servers of local files, and a session for each page."""

from __future__ import annotations

from collections.abc import Sequence

from browser_farm.chrome.devtools import DevTools, EventHandler, Json, browser_url
from browser_farm.chrome.launcher import Chrome
from browser_farm.chrome.tabs import try_launching
from browser_farm.sites.episode import Episode
from browser_farm.sites.login import login_calls
from browser_farm.sites.origins import origin_of, resolver_rules
from browser_farm.sites.routines import Routine
from browser_farm.sites.servers import FolderServer, Refuser
from browser_farm.sites.session import Session
from browser_farm.sites.task_file import SiteTask, load_task
from giirl_core.config.sections import Sandbox
from giirl_core.types import EpisodeSpec, Observation

FRAME = 24, 160  # px of a window around its page: border, tabs, address and a notice


class SiteBrowser:
    """A Chrome that opens episodes of the task files `tasks`, each in a browser context of its own.

    `launch` starts it, again after BrowserGone. `on_event` is called with each event of Chrome. Timeouts are in
    seconds.
    """

    def __init__(
        self,
        tasks: Sequence[str],
        *,
        headless: bool,
        sandbox: Sandbox,
        call_timeout_s: float,
        launch_timeout_s: float,
        on_event: EventHandler,
    ) -> None:
        self.tasks: dict[str, SiteTask] = {name: load_task(name) for name in tasks}
        self.refuser = Refuser()
        self._headless, self._sandbox, self._on_event = headless, sandbox, on_event
        self._call_timeout_s, self._launch_timeout_s = call_timeout_s, launch_timeout_s
        self._chrome: Chrome | None = None
        self._devtools: DevTools | None = None
        self._folders: dict[str, FolderServer] = {}
        self._addresses = {name: self._address_of(task) for name, task in self.tasks.items()}

    @property
    def is_open(self) -> bool:
        """Whether a Chrome was launched and not ended."""
        return self._devtools is not None

    @property
    def tools(self) -> DevTools:
        """The connection to Chrome."""
        assert self._devtools is not None, "launch() comes first"
        return self._devtools

    @property
    def chrome(self) -> Chrome:
        """The Chrome that was launched last."""
        assert self._chrome is not None, "launch() comes first"
        return self._chrome

    def launch(self) -> None:
        """End the current Chrome, if any, and start another. RuntimeError when none starts."""
        try_launching(self._launch_once)

    def close(self) -> None:
        """End Chrome and the servers."""
        self._end_chrome()
        for folder in self._folders.values():
            folder.close()
        self._folders.clear()
        self.refuser.close()

    def begin(
        self, spec: EpisodeSpec, script: str = "", calls: Sequence[tuple[str, Json]] = ()
    ) -> tuple[Episode, Routine[Observation]]:
        """An episode, and the routine that opens its first page.

        `script` runs beside ours in each document, and `calls` are made in the page before it opens.
        """
        task, address = self.tasks[spec.task], self._addresses[spec.task]
        session = Session(
            self.tools,
            proxy=self.refuser.address,
            origins=frozenset({origin_of(address), *(origin.rstrip("/") for origin in task.file.origins)}),
            viewport=task.file.viewport,
            timeout_s=self._call_timeout_s,
            on_refused=self.refuser.count,
            script=script,
            frame=(0, 0) if self._headless else FRAME,
        )
        episode = Episode(task, spec, session, address)
        return episode, episode.begin([*login_calls(task, episode.address), *calls])

    def _address_of(self, task: SiteTask) -> str:
        """The address of a task's first page. Local files are served on loopback, a folder on a port of its own."""
        if task.local_page is None:
            return task.file.address
        folder = str(task.folder.resolve())
        if folder not in self._folders:
            self._folders[folder] = FolderServer(task.folder.resolve())
        return f"{self._folders[folder].origin}/{task.file.address}"

    def _launch_once(self) -> None:
        self._end_chrome()
        origins = {origin for task in self.tasks.values() for origin in task.file.origins}
        flags = [
            f"--host-resolver-rules={resolver_rules({*origins, *map(origin_of, self._addresses.values())})}",
            "--webrtc-ip-handling-policy=disable_non_proxied_udp",
        ]
        self._chrome = Chrome(
            headless=self._headless,
            sandbox=self._sandbox,
            timeout_s=self._launch_timeout_s,
            extra_flags=flags,
        )
        url = browser_url(self._chrome.debugger_address, timeout_s=self._launch_timeout_s)
        self._devtools = DevTools(url, timeout_s=self._launch_timeout_s, on_event=self._on_event)

    def _end_chrome(self) -> None:
        if self._devtools is not None:
            self._devtools.close()
            self._devtools = None
        if self._chrome is not None:
            self._chrome.end()
            self._chrome = None
