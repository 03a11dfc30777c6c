"""Why Chrome did not start, from what it wrote: the line that says it, and what mends it."""

from __future__ import annotations

import re
import socket
import subprocess
import textwrap
from dataclasses import dataclass
from pathlib import Path

INSTALL = "apt-get install chromium chromium-driver"
MAX_LINE = 240  # characters of a quoted line
VERSION_TIMEOUT_S = 20.0
# [pid:thread:date/time:ERROR:file.cc:line] message
CHROME_LINE = re.compile(r"^\[[\d:/.]+:(?P<level>[A-Z]+):[^\]]*\] *(?P<message>.*)$")
# What Chrome, its launcher script and chromedriver also write where nothing is wrong.
NOISE = re.compile(
    r"dbus|D-Bus|zygote_linux\.cc.*Broken pipe|unexpected operator|ChromeDriver|^DevTools listening"
    r"|^Only local connections|^Please (see|protect)"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cause:
    """A known reason why Chrome does not start."""

    fix: str
    pattern: str = ""  # in what Chrome, chromedriver or selenium says
    lasting: bool = True  # another attempt fails alike
    hangs: bool = False  # Chrome runs on, but cannot be used


CAUSES = (
    Cause(
        pattern=r"No usable sandbox|SUID sandbox helper|Failed to move to new namespace|as root without --no-sandbox",
        fix="allow user namespaces (docker run --security-opt seccomp=unconfined), or run Chrome without its sandbox: "
        "actors.chrome_sandbox=off or GIIRL_CHROME_SANDBOX=off",
    ),
    Cause(
        pattern=r"Missing X server|[Cc]annot open display|Unable to open X display",
        fix="a window needs a screen: set DISPLAY, or use xvfb-run",
    ),
    Cause(pattern=r"Too many open files", fix="allow more open files: ulimit -n 4096"),
    Cause(
        pattern=r"remote debugging is disallowed",
        fix="remove RemoteDebuggingAllowed from the policies of this machine (/etc/chromium/policies/managed, "
        "/etc/opt/chrome/policies/managed), or set GIIRL_CHROME to another Chrome",
        hangs=True,
    ),
    Cause(
        pattern=r"only supports Chrome version",
        fix="install the two in one version: apt-get install --only-upgrade chromium chromium-driver",
    ),
    Cause(pattern=r"error while loading shared libraries", fix=f"install what is missing: {INSTALL}"),
    Cause(pattern=r"No space left on device", fix="free some space there, or set TMPDIR to another disk"),
    Cause(
        pattern=r"Resource temporarily unavailable",
        fix="allow more processes: ulimit -u, or docker run --pids-limit",
        lasting=False,
    ),
    Cause(
        pattern=r"Cannot allocate memory|Out of memory",
        fix="free some memory, or use fewer tabs and actors",
        lasting=False,
    ),
)
NO_CHROME = Cause(fix=f"this program is no Chrome: set GIIRL_CHROME to one, or {INSTALL}")
NO_DRIVER = Cause(fix=f"this program is no chromedriver: set GIIRL_CHROMEDRIVER to one, or {INSTALL}")
NO_LOCALHOST = Cause(fix="chromedriver needs the name localhost: add the line '127.0.0.1 localhost' to /etc/hosts")


def find_cause(output: str) -> Cause | None:
    """The known cause that `output` names, if any."""
    return next((cause for cause in CAUSES if re.search(cause.pattern, output)), None)


def find_cause_of_driver(output: str) -> Cause | None:
    """Why a chromedriver ended, if that is known."""
    return find_cause(output) or (None if "ChromeDriver" in output else NO_DRIVER)


def find_cause_of_chrome(output: str, program: Path) -> Cause | None:
    """Why the Chrome in `program` ended, if that is known."""
    if cause := find_cause(output):
        return cause
    if not _is_chrome(program):
        return NO_CHROME
    return None if _has_localhost() else NO_LOCALHOST


def error_line(output: str) -> str:
    """The line of `output` that says most about an error; "" if there is none.

    That is the last line with a known cause, else Chrome's last error, else the last line of anybody else.
    """
    known, errors, others = "", "", ""
    for line in output.splitlines():
        parts = CHROME_LINE.match(line)
        message = parts["message"] if parts else line.strip()
        if find_cause(message):
            known = message
        elif not message or NOISE.search(line):
            continue
        elif parts and parts["level"] in ("ERROR", "FATAL"):
            errors = message
        elif parts is None:
            others = message
    return textwrap.shorten(known or errors or others, MAX_LINE, placeholder=" ...")


def _is_chrome(program: Path) -> bool:
    """Whether a program calls itself a version of Chrome, whoever built it: four numbers."""
    try:
        done = subprocess.run([program, "--version"], capture_output=True, text=True, timeout=VERSION_TIMEOUT_S)
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return False
    return re.search(r"\d+(\.\d+){3}", done.stdout) is not None and "ChromeDriver" not in done.stdout


def _has_localhost() -> bool:
    """Whether the name localhost has an address. Chrome needs none, but chromedriver asks for one to reach it."""
    try:
        return bool(socket.getaddrinfo("localhost", None))
    except OSError:
        return False
