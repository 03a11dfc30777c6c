"""What a task does outside the page: run a program, make a request. In threads, so that other tabs go on."""

from __future__ import annotations

import http.client
import os
import subprocess
import urllib.error
import urllib.request
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

WORKERS = 8
TAIL_CHARACTERS = 200

executor = ThreadPoolExecutor(WORKERS, thread_name_prefix="giirl-outside")


class OutsideError(RuntimeError):
    """The program or the server did not do what the task file asks of it."""


def run_command(command: Sequence[str], folder: Path, values: Mapping[str, str], timeout_s: float) -> int:
    """The exit status of a program that runs in `folder`; it finds the values as GIIRL_NAME in its environment."""
    environment = {**os.environ, **{f"GIIRL_{name.upper()}": value for name, value in values.items()}}
    try:
        done = subprocess.run(
            command, cwd=folder, env=environment, timeout=timeout_s, capture_output=True, stdin=subprocess.DEVNULL
        )
    except OSError as error:
        raise OutsideError(f"cannot run {command[0]}: {error.strerror}") from None
    except subprocess.TimeoutExpired:
        raise OutsideError(f"{command[0]} did not end in {timeout_s:g} s") from None
    if done.returncode not in (0, 1):
        said = done.stderr.decode(errors="replace").strip()[-TAIL_CHARACTERS:]
        raise OutsideError(f"{' '.join(command)} ended with status {done.returncode}: {said}")
    return done.returncode


def run_request(method: str, address: str, timeout_s: float) -> int:
    """The HTTP status of a request without a body."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    request = urllib.request.Request(address, method=method, data=b"" if method == "POST" else None)
    try:
        with opener.open(request, timeout=timeout_s) as response:
            return int(response.status)
    except urllib.error.HTTPError as error:
        error.close()
        return error.code
    except (OSError, http.client.HTTPException, ValueError) as error:
        reason = getattr(error, "reason", error)
        raise OutsideError(f"{method} {address} failed: {reason}") from None
