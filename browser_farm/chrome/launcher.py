"""Launches one Chrome through selenium, with its own directory and session, and ends all of its processes."""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import urlsplit

from selenium import webdriver
from selenium.common.exceptions import WebDriverException
from selenium.webdriver.common.proxy import Proxy, ProxyType
from selenium.webdriver.remote.client_config import ClientConfig
from selenium.webdriver.remote.remote_connection import RemoteConnection
from urllib3.exceptions import HTTPError

from browser_farm.chrome.driver import Driver
from browser_farm.chrome.launch_errors import (
    INSTALL,
    Cause,
    error_line,
    find_cause,
    find_cause_of_chrome,
    find_cause_of_driver,
)
from giirl_core.config.sections import Sandbox
from giirl_core.files import short_temporary_folder

CHROMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome")
DRIVERS = ("chromedriver", "chromium.chromedriver")
SANDBOX_VARIABLE = "GIIRL_CHROME_SANDBOX"
SMALL_SHM_BYTES = 1 << 29
NO_NETWORK = "--host-resolver-rules=MAP * ~NOTFOUND"  # for pages
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
    NO_NETWORK,
    "--js-flags=--max-semi-space-size=2",  # MB; many pages share a heap, whose young generation would grow otherwise
    "--lang=en-US",
    "--log-level=2",  # errors only
    "--metrics-recording-only",
    "--mute-audio",
    "--no-default-browser-check",
    "--no-first-run",
    "--no-pings",
    "--password-store=basic",
    "--window-size=800,600",
)


class CannotLaunch(RuntimeError):
    """Chrome does not start on this machine as it is set up: another attempt would fail alike."""


class ChromeMissing(CannotLaunch):
    """Chrome or chromedriver is not installed."""


class LaunchFailed(RuntimeError):
    """Chrome did not start this time."""


def find(variable: str, names: tuple[str, ...], what: str) -> Path:
    """The absolute path of the program in the environment variable, else of the first of `names` on PATH.

    ChromeMissing when there is none; `what` names the program in the message.
    """
    given = os.environ.get(variable)
    if given:
        if os.access(given, os.X_OK) and Path(given).is_file():
            return Path(given).absolute()
        raise ChromeMissing(f"{variable}={given} is not a program: wanted the path of {what} ({INSTALL})")
    for name in names:
        path = shutil.which(name)
        if path:
            return Path(path).absolute()
    raise ChromeMissing(f"no {what} on PATH (looked for {', '.join(names)}): {INSTALL}, or set {variable}")


def uses_sandbox(wanted: Sandbox) -> bool:
    """Whether Chrome runs in its sandbox: as `wanted`, else as GIIRL_CHROME_SANDBOX says, else unless this is root.

    Raises ValueError for a word that is not a Sandbox.
    """
    for name, value in (("chrome_sandbox", wanted), (SANDBOX_VARIABLE, os.environ.get(SANDBOX_VARIABLE) or "auto")):
        if value not in ("auto", "on", "off"):
            raise ValueError(f"{name} is {value!r}: wanted auto, on or off")
        if value != "auto":
            return value == "on"
    return os.geteuid() != 0  # Chrome refuses to run as root with its sandbox


def check_screen() -> None:
    """ValueError if there is no screen for the windows of a Chrome."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ValueError("there is no screen: DISPLAY is not set, wanted a desktop or xvfb-run")


class Chrome:
    """One running Chrome; `end` kills its processes and removes its files.

    `debugger_address` is host:port and `first_target` the tab that Chrome opens at its start. `hub_url` is a page that
    may script the task pages: an empty file, or `base_url` if a server has them.

    `extra_flags` are added to FLAGS; of two with the same name the last one holds.

    Raises CannotLaunch or LaunchFailed, and ValueError for a wrong GIIRL_CHROME_SANDBOX, or without a screen.
    """

    def __init__(
        self,
        *,
        headless: bool,
        sandbox: Sandbox,
        timeout_s: float,
        base_url: str = "",
        extra_flags: Sequence[str] = (),
    ) -> None:
        with_sandbox = uses_sandbox(sandbox)
        if not headless:
            check_screen()
        self._binary = find("GIIRL_CHROME", CHROMES, "Chrome")
        self._program = find("GIIRL_CHROMEDRIVER", DRIVERS, "chromedriver")
        self._timeout_s = timeout_s
        parent = short_temporary_folder()
        try:
            self.directory = Path(tempfile.mkdtemp(prefix="giirl-chrome-", dir=parent))
        except OSError as error:
            fix = "set TMPDIR to a folder that can be written"
            raise CannotLaunch(f"cannot create a folder for Chrome in {parent}: {error.strerror}; {fix}") from error
        self._driver: Driver | None = None
        self._connection: RemoteConnection | None = None
        self._server = urlsplit(base_url).hostname  # None unless a server has the pages
        try:
            self._launch(self._options(headless, with_sandbox, extra_flags))
            hub = self.directory / "hub.html"
            hub.write_text("<!DOCTYPE html>", encoding="utf-8")
            self.hub_url = base_url if self._server else hub.as_uri()
        except OSError as error:
            self.end()
            raise CannotLaunch(f"Chrome cannot use its folder {self.directory}: {error.strerror}") from error
        except BaseException:
            self.end()
            raise

    def _launch(self, options: webdriver.ChromeOptions) -> None:
        (self.directory / "tmp").mkdir()
        try:
            driver = Driver(self._program, self.directory, {"TZ": "UTC", "TMPDIR": str(self.directory / "tmp")})
        except OSError as error:
            raise self._error(self._program, str(error), find_cause(str(error))) from error
        self._driver = driver
        # Selenium has no timeout for the whole launch. Killing the processes makes its call return.
        watchdog = threading.Timer(self._timeout_s, driver.stop)
        watchdog.daemon = True
        watchdog.start()
        timed_out = watchdog.finished.is_set
        try:
            port = driver.wait_for_port(2 * self._timeout_s)
            if port is None:
                cause = None if timed_out() else find_cause_of_driver(driver.output)
                raise self._error(self._program, driver.output, cause, timed_out=timed_out())
            self._open_session(port, options)
        except (WebDriverException, HTTPError, OSError) as error:
            late = timed_out()
            driver.end()  # then its output is complete
            if late:  # the error is of our making
                raise self._error(self._binary, driver.output, find_cause(driver.output), timed_out=True) from error
            said = f"{_first_line(error)}\n{driver.output}"
            raise self._error(self._binary, said, find_cause_of_chrome(said, self._binary)) from error
        finally:
            watchdog.cancel()
        driver.launched()

    def _open_session(self, port: int, options: webdriver.ChromeOptions) -> None:
        """Let the chromedriver at this port start Chrome."""
        config = ClientConfig(
            remote_server_addr=f"http://127.0.0.1:{port}",
            proxy=Proxy({"proxyType": ProxyType.DIRECT}),
            timeout=math.ceil(self._timeout_s),
        )
        self._connection = RemoteConnection(client_config=config)
        session = webdriver.Remote(command_executor=self._connection, options=options)
        # The address names the host, "localhost", which may stand for ::1 alone.
        debugger_port = str(session.capabilities["goog:chromeOptions"]["debuggerAddress"]).rpartition(":")[2]
        self.debugger_address = f"127.0.0.1:{debugger_port}"
        self.first_target = str(session.current_window_handle)

    def _error(self, program: Path, said: str, cause: Cause | None, *, timed_out: bool = False) -> RuntimeError:
        """What to raise for a program that has `said` this: CannotLaunch if another attempt would fail alike."""
        when = f" within {self._timeout_s:g} s" if timed_out else ""
        if timed_out:  # a shell that started the program reports how it was killed here
            said = "\n".join(line for line in said.splitlines() if line.strip() != "Killed")
        why = error_line(said) or "it said nothing"
        message = f"{program} did not start{when}: {why}{f'; {cause.fix}' if cause else ''}"
        return CannotLaunch(message) if cause and cause.lasting else LaunchFailed(message)

    def _options(self, headless: bool, with_sandbox: bool, extra_flags: Sequence[str]) -> webdriver.ChromeOptions:
        options = webdriver.ChromeOptions()
        options.binary_location = str(self._binary)
        flags = [*FLAGS, *extra_flags, f"--user-data-dir={self.directory}/profile"]
        if headless:
            flags.append("--headless=new")
        if self._server:
            flags.append(f"{NO_NETWORK}, EXCLUDE {self._server}")  # of a flag that is given twice the last one holds
        if not with_sandbox:
            flags.append("--no-sandbox")
        if not Path("/dev/shm").is_dir() or shutil.disk_usage("/dev/shm").free < SMALL_SHM_BYTES:
            flags.append("--disable-dev-shm-usage")
        for flag in flags:
            options.add_argument(flag)
        return options

    def end(self) -> None:
        """Kill the process tree and remove the directory. Nothing in the profile is worth a clean shutdown.

        In a fork of the process that launched it, Chrome is left alone.
        """
        if self._connection is not None:
            self._connection.close()  # type: ignore[no-untyped-call]
        if self._driver is not None:
            self._driver.end()
        else:
            shutil.rmtree(self.directory, ignore_errors=True)


def _first_line(error: Exception) -> str:
    """The message of a selenium error, without stack trace and link to the documentation."""
    first = str(error).partition("\n")[0].removeprefix("Message: ").partition("; For documentation")[0]
    return first or type(error).__name__
