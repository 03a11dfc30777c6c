"""Kills a farm's browser again and again, and counts what stays behind of it.

    python benchmarks/relaunches.py [--times 200] [--json FILE]

After each kill the farm has to play on. Counted before and after: browsers, child processes, open file descriptors,
threads, and folders in the temporary directory. Exit status 1 where any of them has grown.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import psutil

from browser_farm.chrome import reaper
from browser_farm.farm import ChromeFarm
from giirl_core.files import write_json
from giirl_core.progress import Display
from giirl_core.types import Command, EpisodeSpec, Verb

SETTLED_S = 20.0  # for what has been killed to be gone


def count(farm: ChromeFarm, folder: Path) -> dict[str, int]:
    """What there is now."""
    return {
        "chromes": sum(_is_browser(pid) for pid in reaper.processes(Path(farm.chrome_directory))),
        "children": len(psutil.Process().children()),
        "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        "threads": threading.active_count(),
        "folders": len(list(folder.glob("giirl-chrome-*"))),
    }


def _is_browser(pid: int) -> bool:
    """A browser process, and neither its driver nor one of its helpers."""
    try:
        words = psutil.Process(pid).cmdline()
    except psutil.NoSuchProcess:
        return False
    return any(word.startswith("--user-data-dir=") for word in words) and not any("--type=" in w for w in words)


def kill_browser(farm: ChromeFarm) -> None:
    for pid in reaper.processes(Path(farm.chrome_directory)):
        if _is_browser(pid):
            os.kill(pid, signal.SIGKILL)


def run(times: int, folder: Path) -> dict[str, Any]:
    """Kill and play on so many times; `folder` is where the farm's own folders appear."""
    slowest = 0.0
    with ChromeFarm(tabs=1, call_timeout_s=20.0) as farm, Display().job("relaunches", times) as job:
        farm.reset({0: EpisodeSpec(task="click-test", seed=0)})
        before = count(farm, folder)
        for number in range(times):
            kill_browser(farm)
            since = time.monotonic()
            result = farm.step({0: Command(verb=Verb.WAIT, following=EpisodeSpec(task="click-test", seed=number))})[0]
            assert (result.lost, result.observation is None) == ("browser_died", False), result
            slowest = max(slowest, time.monotonic() - since)
            job.advance(1, f"{slowest:.1f} s at most")
        deadline = time.monotonic() + SETTLED_S
        while (after := count(farm, folder)) != before and time.monotonic() < deadline:
            time.sleep(0.2)
    return {"times": times, "slowest_s": round(slowest, 2), "before": before, "after": after}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--json", type=Path)
    wanted = parser.parse_args()
    found = run(wanted.times, Path(tempfile.gettempdir()))
    if wanted.json is not None:
        write_json(wanted.json, found)
    print(json.dumps(found))  # noqa: T201
    return 0 if all(found["after"][name] <= before for name, before in found["before"].items()) else 1


if __name__ == "__main__":
    sys.exit(main())
