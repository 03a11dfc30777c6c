"""Launches one Chrome through selenium, with its own directory and session, and ends all of its processes."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

from selenium import webdriver
from selenium.common.exceptions import WebDriverException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.proxy import Proxy, ProxyType
from selenium.webdriver.remote.client_config import ClientConfig
from selenium.webdriver.remote.remote_connection import RemoteConnection
from urllib3.exceptions import HTTPError

from browser_farm.chrome import reaper

INSTALL = "apt-get install chromium chromium-driver"
CHROMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome")
DRIVERS = ("chromedriver", "chromium.chromedriver")
SMALL_SHM_BYTES = 1 << 29
MAX_DIRECTORY_LENGTH = 30  # characters; Chrome adds about 75, and the path of a Unix socket holds 107
FLAGS = (
    "--allow-file-access-from-files",  # pages read their own style sheets
    "--disable-background-networking",
    "--disable-background-timer-throttling",
    "--disable-backgrounding-occluded-windows",
    "--disable-breakpad",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-extensions",
    # Features for people that each start a process, or download something.
    "--disable-features=Translate,OptimizationHints,MediaRouter,DialMediaRouteProvider,"
    "SpareRendererForSitePerProcess,WebUIOmniboxPopup,WebUIOmniboxAimPopup,AutofillServerCommunication",
    "--disable-gpu",
    "--disable-hang-monitor",
    "--disable-ipc-flooding-protection",
    "--disable-popup-blocking",
    "--disable-prompt-on-repost",
    "--disable-quic",
    "--disable-renderer-backgrounding",
    "--disable-smooth-scrolling",
    "--disable-sync",
    "--enable-features=NetworkServiceInProcess2",
    "--force-color-profile=srgb",
    "--force-device-scale-factor=1",
    "--host-resolver-rules=MAP * ~NOTFOUND",  # a page has no network
    "--js-flags=--max-semi-space-size=2",  # MB; many pages share a heap, whose young generation would grow otherwise
    "--lang=en-US",
    "--metrics-recording-only",
    "--mute-audio",
    "--no-default-browser-check",
    "--no-first-run",
    "--no-pings",
    "--password-store=basic",
    "--window-size=800,600",
)


class ChromeMissing(RuntimeError):
    """Chrome or chromedriver is not installed."""


class LaunchFailed(RuntimeError):
    """Chrome is installed but did not start."""


def find(variable: str, names: tuple[str, ...], what: str) -> Path:
    """The program whose path is in the environment variable, else the first of `names` on PATH.

    ChromeMissing when there is none; `what` names the program in the message.
    """
    given = os.environ.get(variable)
    if given:
        if os.access(given, os.X_OK) and Path(given).is_file():
            return Path(given)
        raise ChromeMissing(f"{variable}={given} is not a program: wanted the path of {what} ({INSTALL})")
    for name in names:
        path = shutil.which(name)
        if path:
            return Path(path)
    raise ChromeMissing(f"no {what} on PATH (looked for {', '.join(names)}): {INSTALL}, or set {variable}")


def _first_line(error: Exception) -> str:
    """The message of a selenium error, without stack trace and link to the documentation."""
    first = str(error).partition("\n")[0].removeprefix("Message: ").partition("; For documentation")[0]
    return first or type(error).__name__


def _short_directory() -> str:
    """The directory for temporary files, or /tmp if the path of Chrome's socket in it would be too long."""
    default = tempfile.gettempdir()
    return default if len(default) <= MAX_DIRECTORY_LENGTH else "/tmp"


class Chrome:
    """One running Chrome; `end` kills its processes and removes its files.

    `debugger_address` is host:port and `first_target` the tab that Chrome opens at its start. `hub_url` is an empty
    file:// page, which may script the task pages.

    Raises ChromeMissing or LaunchFailed. `flags` are added to FLAGS; of two with the same name the last one holds.
    """

    def __init__(self, *, headless: bool, no_sandbox: bool | None, timeout_s: float, flags: Sequence[str] = ()) -> None:
        self._extra_flags = tuple(flags)
        binary = find("GIIRL_CHROME", CHROMES, "Chrome")
        driver = find("GIIRL_CHROMEDRIVER", DRIVERS, "chromedriver")
        parent = _short_directory()
        try:
            self.directory = Path(tempfile.mkdtemp(prefix="giirl-chrome-", dir=parent))
        except OSError as error:
            raise LaunchFailed(f"cannot create a folder for Chrome in {parent}: {error.strerror}") from error
        self._service: Service | None = None
        self._connection: RemoteConnection | None = None
        self._reaper = reaper.Reaper(self.directory)
        try:
            session = self._launch(binary, driver, headless, no_sandbox, timeout_s)
            self.debugger_address = str(session.capabilities["goog:chromeOptions"]["debuggerAddress"])
            self.first_target = str(session.current_window_handle)
            hub = self.directory / "hub.html"
            hub.write_text("<!DOCTYPE html>", encoding="utf-8")
            self.hub_url = hub.as_uri()
        except OSError as error:
            self.end()
            raise LaunchFailed(f"Chrome cannot use its folder {self.directory}: {error.strerror}") from error
        except BaseException:
            self.end()
            raise

    def _launch(
        self, binary: Path, driver: Path, headless: bool, no_sandbox: bool | None, timeout_s: float
    ) -> webdriver.Remote:
        (self.directory / "tmp").mkdir()
        options = webdriver.ChromeOptions()
        options.binary_location = str(binary)
        for flag in self._flags(headless, no_sandbox):
            options.add_argument(flag)
        environment = {
            reaper.DIRECTORY_VARIABLE: str(self.directory),
            "TZ": "UTC",
            "TMPDIR": str(self.directory / "tmp"),
        }
        self._service = Service(
            executable_path=str(driver),
            log_output=subprocess.DEVNULL,
            # A session of its own, so that Ctrl-C in the terminal reaches the owner only.
            popen_kw={"start_new_session": True},
            env={**os.environ, **environment},
        )
        # Selenium has no timeout for the whole launch. Killing the processes makes its call return.
        watchdog = threading.Timer(timeout_s, reaper.reap, [self.directory])
        watchdog.daemon = True
        watchdog.start()
        try:
            self._service.start()
            config = ClientConfig(
                remote_server_addr=self._service.service_url,
                proxy=Proxy({"proxyType": ProxyType.DIRECT}),
                timeout=math.ceil(timeout_s),
            )
            self._connection = RemoteConnection(client_config=config)
            return webdriver.Remote(command_executor=self._connection, options=options)
        except (WebDriverException, HTTPError, OSError) as error:
            raise LaunchFailed(f"{binary} did not start within {timeout_s:g} s: {_first_line(error)}") from error
        finally:
            watchdog.cancel()

    def _flags(self, headless: bool, no_sandbox: bool | None) -> list[str]:
        flags = [*FLAGS, *self._extra_flags, f"--user-data-dir={self.directory}/profile"]
        if headless:
            flags.append("--headless=new")
        if os.geteuid() == 0 if no_sandbox is None else no_sandbox:
            flags.append("--no-sandbox")  # Chrome refuses to run as root with its sandbox
        if not Path("/dev/shm").is_dir() or shutil.disk_usage("/dev/shm").free < SMALL_SHM_BYTES:
            flags.append("--disable-dev-shm-usage")
        return flags

    def end(self) -> None:
        """Kill the process tree and remove the directory. Nothing in the profile is worth a clean shutdown."""
        reaper.reap(self.directory)
        if self._connection is not None:
            self._connection.close()  # type: ignore[no-untyped-call]
        process = getattr(self._service, "process", None)  # missing when chromedriver could not be started
        if process is not None:
            process.wait(timeout=reaper.TIMEOUT_S)
            process.stdin.close()
        self._reaper.end()
