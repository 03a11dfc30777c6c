"""The version of the code that worker processes run: a hash of its files. A learner never mixes two versions."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

PACKAGES = ("actors", "browser_farm", "giirl_core", "reward_service")
ROOT = Path(__file__).parent.parent.parent


@cache
def code_version() -> str:
    """Eight hex digits that differ when a file of these packages differs."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            if path.suffix in (".py", ".js"):
                digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:8]
