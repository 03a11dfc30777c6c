"""Commands that run a program as on another machine: without user namespaces, with other names, as process 1."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TIMEOUT_S = 100.0

# An ordinary user who may create no user namespace: user 1000 of a namespace that allows none below it.
NO_NAMESPACES = (
    "unshare --user --map-user=1000 --map-group=1000 --keep-caps sh -c "
    "'echo 0 >/proc/sys/user/max_user_namespaces && "
    'exec setpriv --bounding-set=-all --inh-caps=-all --ambient-caps=-all "$@"\' -'
)
PROCESS_1 = "unshare --pid --fork --mount-proc"  # as in a container; needs root
NO_LOOPBACK = "unshare --net"  # a loopback interface that is down; needs root

LAUNCH = """
import sys
from browser_farm.farm import ChromeFarm
from giirl_core.types import EpisodeSpec
try:
    with ChromeFarm(tabs=1, launch_timeout_s=30.0, headless="window" not in sys.argv) as farm:
        print(farm.reset({0: EpisodeSpec(task="click-test", seed=1)})[0].goal.utterance)
except (RuntimeError, ValueError) as error:
    print(error)
"""
OPENED = "Click the button."  # what LAUNCH prints where Chrome starts


def mounted(folder: Path, place: str) -> str:
    """A machine on which `place` holds what `folder` holds; needs root."""
    return f"unshare --mount sh -c 'mount --bind {folder} {place} && exec \"$@\"' -"


def run(machine: str, *command: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run Python with these arguments and environment variables; skips the test where `machine` cannot be had."""
    words = f'{machine} "$@"' if machine else '"$@"'
    if machine and subprocess.run(["sh", "-c", words, "-", "true"], capture_output=True).returncode:
        pytest.skip(f"not possible here: {machine}")
    return subprocess.run(
        ["sh", "-c", words, "-", sys.executable, *command],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT), **variables},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )


def launch(machine: str = "", *words: str, **variables: str) -> str:
    """What LAUNCH prints: the instruction of a page, or the error."""
    done = run(machine, "-c", LAUNCH, *words, **variables)
    assert done.returncode == 0, done.stderr
    return done.stdout.removesuffix("\n")


def counted(folder: Path, chrome: str) -> Path:
    """A program that counts its starts in `folder`/starts and then is `chrome`, lines of a shell script."""
    program = folder / "chrome"
    version = '[ "$1" = --version ] && { echo Chromium 156.0.8078.108; exit; }'
    program.write_text(f"#!/bin/sh\n{version}\necho start >>{folder}/starts\n{chrome}\n")
    program.chmod(0o755)
    return program


def starts(folder: Path) -> int:
    return (folder / "starts").read_text().count("start")


def script(*lines: str) -> Sequence[str]:
    """The arguments of Python for a script of these lines."""
    return ("-c", "\n".join(lines))
