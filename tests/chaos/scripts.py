"""Runs the scripts of this folder as separate processes: they fork, which a test process with threads must not do."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent.parent


def run_script(module: str, folder: Path, *arguments: str, timeout_s: float, result: str) -> dict[str, Any]:
    """Run a script of this folder to its end and return the JSON that it wrote to the file `result`."""
    log = folder / f"{module}.log"
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", f"tests.chaos.{module}", str(folder), *arguments],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=file,
            start_new_session=True,
        )
        try:
            status = process.wait(timeout_s)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait(10)
    assert status == 0, "\n".join(log.read_text(errors="replace").splitlines()[-20:])
    content: dict[str, Any] = json.loads((folder / result).read_text())
    return content
