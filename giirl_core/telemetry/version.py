"""Which code runs: the version of the distribution, and the commit of an image or a checkout."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import subprocess
from pathlib import Path

VERSION = importlib.metadata.version("giirl")
REVISION = os.environ.get("GIIRL_REVISION", "")  # the commit that an image was built from
GIT_TIMEOUT_S = 10.0


@functools.cache
def commit() -> str:
    """REVISION, or the commit of this checkout, with "+" if files differ; "" if neither is known."""
    root = Path(__file__).parents[2]
    if REVISION or not (root / ".git").exists():
        return REVISION
    command = ["git", "-C", str(root), "describe", "--always", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=GIT_TIMEOUT_S).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
