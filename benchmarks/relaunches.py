"""Kills a farm's browser repeatedly, and counts the resources that are not released.

    python benchmarks/relaunches.py [--times 200] [--json FILE]

After each kill the farm must play on. Counts before and after: browsers, child processes, open file descriptors,
threads, and folders in the temporary directory. Exit status 1 if any count has grown.
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
from giirl_core.files import writable, write_json
from giirl_core.progress import Display
from giirl_core.types import Command, EpisodeSpec, Verb

SETTLE_TIMEOUT_S = 20.0  # for killed processes to disappear


def count(farm: ChromeFarm, folder: Path) -> dict[str, int]:
    """The current number of each resource."""
    return {
        "chromes": sum(_is_browser(pid) for pid in reaper.processes(Path(farm.chrome_directory))),
        "children": len(psutil.Process().children()),
        "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        "threads": threading.active_count(),
        "folders": len(list(folder.glob("giirl-chrome-*"))),
    }


def _is_browser(pid: int) -> bool:
    """Whether a process is the browser itself, not its driver or a helper process."""
    try:
        arguments = psutil.Process(pid).cmdline()
    except psutil.NoSuchProcess:
        return False
    is_main = not any("--type=" in argument for argument in arguments)
    return is_main and any(argument.startswith("--user-data-dir=") for argument in arguments)


def kill_browser(farm: ChromeFarm) -> None:
    """Kill the farm's browser with SIGKILL."""
    for pid in reaper.processes(Path(farm.chrome_directory)):
        if _is_browser(pid):
            os.kill(pid, signal.SIGKILL)


def run(times: int, folder: Path) -> dict[str, Any]:
    """Kill the browser and play on `times` times. `folder` is the temporary directory of the farm's folders."""
    slowest = 0.0
    with ChromeFarm(tabs=1, call_timeout_s=20.0) as farm, Display().job("relaunches", times) as job:
        farm.reset({0: EpisodeSpec(task="click-test", seed=0)})
        before = count(farm, folder)
        for number in range(times):
            kill_browser(farm)
            start = time.monotonic()
            result = farm.step({0: Command(verb=Verb.WAIT, following=EpisodeSpec(task="click-test", seed=number))})[0]
            assert (result.lost, result.observation is None) == ("browser_died", False), result
            slowest = max(slowest, time.monotonic() - start)
            job.advance(1, f"slowest {slowest:.1f} s")
        deadline = time.monotonic() + SETTLE_TIMEOUT_S
        while (after := count(farm, folder)) != before and time.monotonic() < deadline:
            time.sleep(0.2)
    return {"times": times, "slowest_s": round(slowest, 2), "before": before, "after": after}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--times", type=int, default=200)
    parser.add_argument("--json", type=writable)
    arguments = parser.parse_args()
    result = run(arguments.times, Path(tempfile.gettempdir()))
    if arguments.json is not None:
        write_json(arguments.json, result)
    print(json.dumps(result))  # noqa: T201
    return 0 if all(result["after"][name] <= before for name, before in result["before"].items()) else 1


if __name__ == "__main__":
    sys.exit(main())
