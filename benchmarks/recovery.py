"""How soon a run is whole again after a part of it was killed: an actor, a replica of the reward service, the learner.

    python -m benchmarks.recovery [--times 3] [--json FILE]

A run with real Chrome on a Ray cluster of one node, as `ray start --head` makes it. Everything is killed with SIGKILL.
An actor is back when its new incarnation has begun, and plays when that has finished its first episode (Chrome's start
lies in between); a replica, when the process in its place has weights; the learner, when the
process that resumes the run, timed from its start, has made a step that was not in the checkpoint.
"""

from __future__ import annotations

import argparse
import http.client
import json
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil

from actors.episode_counter import read_counts
from giirl_core.files import write_json
from giirl_core.processes.supervision import CRASHES
from giirl_core.progress import Display, Job
from learner.checkpoint import latest_checkpoint
from tests.end_to_end.cluster import ray_cluster
from tests.end_to_end.commands import Command, find, run_folder, scrape, step, total

WORDS = (
    "runtime=ray",
    "iterations=100000",
    "checkpoint_every=10",
    "scoring.replicas=2",
    "demos.per_task=8",
    "actors.heartbeat_timeout_s=20.0",
)
START_S = 200.0
LOOK_S = 0.05  # a look costs milliseconds of the cores that recover


def since(begun_s: float, true: Callable[[], object]) -> float:
    """Seconds until something became true."""
    while not true():
        if time.monotonic() - begun_s > START_S:
            raise TimeoutError(f"not whole again after {START_S} s")
        time.sleep(LOOK_S)
    return round(time.monotonic() - begun_s, 2)


def kill(process: psutil.Process) -> float:
    process.kill()
    return time.monotonic()


def measure(times: int, display: Display) -> dict[str, Any]:
    """Kill each so many times."""
    found: dict[str, list[float]] = {name: [] for name in ("actor_back_s", "actor_plays_s", "replica_s", "learner_s")}
    with ray_cluster() as (head, _, driver), run_folder() as run, ExitStack() as inside:
        env = {**driver, "TMPDIR": str(head.temporary)}
        job = inside.enter_context(display.job("kills", 3 * times))
        with Command("train", *WORDS, f"run={run}", env=env) as learner:
            learner.until(lambda: step(run) > 10, "first checkpoint", timeout_s=START_S)
            tally = head.temporary / "giirl" / (run / "identity").read_text() / "actor-0.tally"
            for _ in range(times):
                before, (actor,) = newest(tally)[0], find(head, "ray::ActorProcess")
                killed_s = kill(actor)
                found["actor_back_s"].append(since(killed_s, lambda: newest(tally)[0] > before))  # noqa: B023
                found["actor_plays_s"].append(since(killed_s, lambda: newest(tally)[1]))
                settle(learner, run, job)
            for _ in range(times):
                known = set(find(head, "ray::RewardProcess"))
                killed_s = kill(min(known, key=lambda process: process.pid))
                found["replica_s"].append(
                    since(killed_s, lambda: any(map(serves, set(find(head, "ray::RewardProcess")) - known)))  # noqa: B023
                )
                settle(learner, run, job)
        for _ in range(times):  # leaving the block has killed the last one
            saved, begun_s = int(latest_checkpoint(run / "checkpoints").name.split("-")[1]), time.monotonic()
            curve = (run / "curve.jsonl").stat().st_ino  # of another file once it has been cut
            with Command("train", "--resume", str(run), env=env) as learner:
                found["learner_s"].append(
                    since(begun_s, lambda: (run / "curve.jsonl").stat().st_ino != curve and step(run) > saved)  # noqa: B023
                )
                settle(learner, run, job)
    medians = {name.replace("_s", "_median_s"): round(statistics.median(some), 2) for name, some in found.items()}
    return {"times": times, **medians, **found}


def settle(learner: Command, run: Path, job: Job) -> None:
    """Let the run go on for a while."""
    reached = step(run)
    learner.until(lambda: step(run) > reached + 10, "further steps", timeout_s=START_S)
    job.advance(1)


def newest(tally: Path) -> tuple[int, int]:
    """The last incarnation of an actor, and how much it has finished."""
    return read_counts(tally)[-1]


def serves(replica: psutil.Process) -> bool:
    """Whether a reward service has weights to score with, by what one of its ports says."""
    try:
        ports = {c.laddr.port for c in replica.net_connections("tcp") if c.status == psutil.CONN_LISTEN}
    except psutil.NoSuchProcess:
        return False
    with ThreadPoolExecutor() as pool:
        return any(version > 0 for version in pool.map(_version, ports))


def _version(port: int) -> float:
    try:
        return total(scrape(f"127.0.0.1:{port}", 2 * LOOK_S), "giirl_reward_version")
    except (OSError, ValueError, http.client.HTTPException):
        return -1.0  # another port of it


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--times", type=int, default=3, choices=range(1, CRASHES - 1), help="kills of each; more are a crash loop"
    )
    parser.add_argument("--json", type=Path, help="write the numbers here")
    arguments = parser.parse_args()
    result = {"recovery": measure(arguments.times, Display())}
    if arguments.json:
        write_json(arguments.json, result)
    print(json.dumps(result, indent=2))  # noqa: T201


if __name__ == "__main__":
    main()
