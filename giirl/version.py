"""Which code runs: the version of the distribution, and the commit of a checkout."""

from __future__ import annotations

import functools
import importlib.metadata
import subprocess
from pathlib import Path

VERSION = importlib.metadata.version("giirl")
GIT_TIMEOUT_S = 10.0


@functools.cache
def commit() -> str:
    """The git commit of the checkout that this code is in, with "+" if files differ from it; "" outside a checkout."""
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=GIT_TIMEOUT_S).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
