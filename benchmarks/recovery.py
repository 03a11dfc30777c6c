"""Recovery time of a run after the kill of an actor, of a replica of the reward service, or of the learner.

    python -m benchmarks.recovery [--times 3] [--json FILE]

The run uses real Chrome, on a Ray cluster of one node as `ray start --head` starts it. All kills are SIGKILL. An actor
has recovered when its new incarnation has started, and plays when that has finished its first episode; Chrome starts in
between. A replica has recovered when its replacement has weights. The learner has recovered when the process that
resumes the run, timed from its start, has made a step beyond the checkpoint.
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
from giirl_core.files import writable, write_json
from giirl_core.processes.supervision import MAX_CRASHES
from giirl_core.progress import Display, Job
from learner.checkpoint import latest_checkpoint
from tests.end_to_end.cluster import ray_cluster
from tests.end_to_end.commands import Command, find, run_folder, scrape, step, total

SETTINGS = (
    "runtime=ray",
    "iterations=100000",
    "checkpoint_every=10",
    "scoring.replicas=2",
    "demos.per_task=8",
    "actors.heartbeat_timeout_s=20.0",
)
TIMEOUT_S = 200.0
POLL_S = 0.05  # each poll takes milliseconds from the cores that recover


def recovery_s(start_s: float, condition: Callable[[], object]) -> float:
    """Seconds from `start_s` until the condition holds. TimeoutError after TIMEOUT_S."""
    while not condition():
        if time.monotonic() - start_s > TIMEOUT_S:
            raise TimeoutError(f"the run has not recovered within {TIMEOUT_S} s")
        time.sleep(POLL_S)
    return round(time.monotonic() - start_s, 2)


def kill(process: psutil.Process) -> float:
    """Kill a process. Returns the time of the kill."""
    process.kill()
    return time.monotonic()


def measure(times: int, display: Display) -> dict[str, Any]:
    """Kill each part `times` times. Returns all recovery times and their medians, in seconds."""
    seconds: dict[str, list[float]] = {name: [] for name in ("actor_back_s", "actor_plays_s", "replica_s", "learner_s")}
    with ray_cluster() as (head, _, driver), run_folder() as run, ExitStack() as stack:
        env = {**driver, "TMPDIR": str(head.temporary)}
        job = stack.enter_context(display.job("kills", 3 * times))
        with Command("train", *SETTINGS, f"run={run}", env=env) as learner:
            learner.until(lambda: step(run) > 10, "first checkpoint", timeout_s=TIMEOUT_S)
            counts = head.temporary / "giirl" / (run / "identity").read_text(encoding="utf-8") / "actor-0.count"
            for _ in range(times):
                before, (actor,) = last_incarnation(counts)[0], find(head, "ray::ActorProcess")
                killed_s = kill(actor)
                seconds["actor_back_s"].append(recovery_s(killed_s, lambda: last_incarnation(counts)[0] > before))  # noqa: B023
                seconds["actor_plays_s"].append(recovery_s(killed_s, lambda: last_incarnation(counts)[1]))
                run_on(learner, run, job)
            for _ in range(times):
                known = replicas(head)
                killed_s = kill(min(known, key=lambda process: process.pid))
                seconds["replica_s"].append(
                    recovery_s(killed_s, lambda: any(map(has_weights, replicas(head) - known)))  # noqa: B023
                )
                run_on(learner, run, job)
        for _ in range(times):  # the learner of the block above was killed when the block ended
            saved, start_s = int(latest_checkpoint(run / "checkpoints").name.split("-")[1]), time.monotonic()
            curve = (run / "curve.jsonl").stat().st_ino  # resuming truncates the curve, which creates a new file
            with Command("train", "--resume", str(run), env=env) as learner:
                seconds["learner_s"].append(
                    recovery_s(start_s, lambda: (run / "curve.jsonl").stat().st_ino != curve and step(run) > saved)  # noqa: B023
                )
                run_on(learner, run, job)
    medians = {name.replace("_s", "_median_s"): round(statistics.median(some), 2) for name, some in seconds.items()}
    return {"times": times, **medians, **seconds}


def run_on(learner: Command, run: Path, job: Job) -> None:
    """Let the run make some more steps."""
    reached = step(run)
    learner.until(lambda: step(run) > reached + 10, "further steps", timeout_s=TIMEOUT_S)
    job.advance(1)


def last_incarnation(counts: Path) -> tuple[int, int]:
    """The last incarnation of an actor, and how many episodes it has finished."""
    return read_counts(counts)[-1]


def replicas(head: Command) -> set[psutil.Process]:
    """The processes of the reward service."""
    return set(find(head, "ray::RewardProcess"))


def has_weights(replica: psutil.Process) -> bool:
    """Whether a reward service has weights, according to the metrics on one of its ports."""
    try:
        ports = {c.laddr.port for c in replica.net_connections("tcp") if c.status == psutil.CONN_LISTEN}
    except psutil.NoSuchProcess:
        return False
    with ThreadPoolExecutor() as pool:
        return any(version > 0 for version in pool.map(_version, ports))


def _version(port: int) -> float:
    try:
        return total(scrape(f"127.0.0.1:{port}", 2 * POLL_S), "giirl_reward_version")
    except (OSError, ValueError, http.client.HTTPException):
        return -1.0  # not the metrics port


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--times", type=int, default=3, choices=range(1, MAX_CRASHES - 1), help="kills per part; more are a crash loop"
    )
    parser.add_argument("--json", type=writable, help="write the result to this file")
    arguments = parser.parse_args()
    result = {"recovery": measure(arguments.times, Display())}
    if arguments.json:
        write_json(arguments.json, result)
    print(json.dumps(result, indent=2))  # noqa: T201


if __name__ == "__main__":
    main()
