"""A run in which one process after the other is killed, and what could be seen of it meanwhile."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import urllib.error
import urllib.parse
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from tests.end_to_end.commands import (
    ANSWER_S,
    GONE_S,
    LOOPBACK,
    Command,
    Sample,
    command_line,
    read_json,
    step,
    targets,
    total,
    try_scrape,
)

TASKS = ("click-test-2", "click-button")
WORDS = (
    "train",
    "runtime=local",
    f"tasks={json.dumps(TASKS)}",
    "iterations=120",
    "rollout_batch=8",
    "checkpoint_every=5",
    "demos.per_task=20",
    "evaluate.episodes=20",
    "evaluate.random_episodes=20",
    "actors.score_timeout_s=1.0",
)


@dataclass(slots=True, kw_only=True)
class Survival:
    """What was seen while the run went on, and after it."""

    run: Path
    status: int = -1
    said: str = ""  # on standard output and standard error
    left: list[str] = field(default_factory=list)
    healthy: dict[str, Sample] = field(default_factory=dict)  # job -> its metrics before anything was killed
    watched: dict[str, float] | None = None  # job -> `up`, by a real Prometheus; None where there is none
    watched_steps: float = 0.0  # giirl_env_steps_total, by the same
    after_chrome: Sample = field(default_factory=dict)  # of the actor whose Chrome was killed
    actors: list[int] = field(default_factory=list)  # pids of actor-0, in their order
    incarnations: list[int] = field(default_factory=list)  # of actor-0, in checkpoints before and after it was killed
    after_actor: Sample = field(default_factory=dict)  # of the second of them
    services: list[int] = field(default_factory=list)
    after_service: Sample = field(default_factory=dict)
    learner: Sample = field(default_factory=dict)  # the last that was seen of it


def survive(run: Path) -> Survival:
    """Start the run, kill its parts, see it end."""
    seen = Survival(run=run)
    with Command(*WORDS, f"run={run}") as command:
        _see_healthy(command, seen)
        _kill_chrome(command, seen)
        _kill_actor(command, seen)
        _kill_service(command, seen)
        seen.learner = try_scrape(run, "learner")
        seen.status = command.wait(timeout_s=150)
        seen.said = command.said
        seen.left = command.remains()
    seen.incarnations.append(_incarnation(run))
    return seen


def _see_healthy(command: Command, seen: Survival) -> None:
    def all_at_work() -> bool:
        jobs = ("learner", "actor-0", "reward-service-0")
        seen.healthy = {job: try_scrape(seen.run, job) for job in jobs}
        return (
            all(seen.healthy.values())
            and total(seen.healthy["learner"], "giirl_trajectories_trained_total", reward_source="service") > 0
        )

    command.until(lambda: step(seen.run) > 0, "first iteration")
    command.until(all_at_work, "rewards of the service and metrics of every process")
    with prometheus(seen.run.parent) as ask:
        if ask:
            seen.watched = {}

            def watched() -> bool:
                seen.watched = {row["metric"]["process"]: float(row["value"][1]) for row in ask("up")}
                steps = ask("sum(giirl_env_steps_total{process='actor-0'})")
                seen.watched_steps = float(steps[0]["value"][1]) if steps else 0.0
                return sum(seen.watched.values()) == 3 and seen.watched_steps > 0

            command.until(watched, "Prometheus scraping the three of them", timeout_s=30)


def _kill_chrome(command: Command, seen: Survival) -> None:
    def recovered() -> bool:
        seen.after_chrome = try_scrape(seen.run, "actor-0")
        return total(seen.after_chrome, "giirl_env_steps_total") > before + 20

    before = total(try_scrape(seen.run, "actor-0"), "giirl_env_steps_total")
    _chrome(_find(command, "ray::ActorProcess")).send_signal(signal.SIGKILL)
    restarted = ("giirl_browser_recoveries_total", "browser_died")
    command.until(lambda: total(try_scrape(seen.run, "actor-0"), restarted[0], cause=restarted[1]) > 0, "new Chrome")
    before = total(try_scrape(seen.run, "actor-0"), "giirl_env_steps_total")
    command.until(recovered, "steps in the new Chrome")


def _kill_actor(command: Command, seen: Survival) -> None:
    def recovered() -> bool:
        seen.after_actor = try_scrape(seen.run, "actor-0") if targets(seen.run).get("actor-0") != before else {}
        return total(seen.after_actor, "giirl_episodes_total") > 0 and step(seen.run) > reached + 1

    before, reached = targets(seen.run)["actor-0"], step(seen.run)
    command.until(lambda: bool(_marks(seen.run)), "a checkpoint that knows the actor")
    seen.incarnations = [_incarnation(seen.run)]
    process = _find(command, "ray::ActorProcess")
    process.kill()
    command.until(recovered, "episodes of a new actor")
    seen.actors = [process.pid, _find(command, "ray::ActorProcess").pid]


def _kill_service(command: Command, seen: Survival) -> None:
    def recovered() -> bool:
        known = targets(seen.run).get("reward-service-0")
        seen.after_service = try_scrape(seen.run, "reward-service-0") if known != before else {}
        return total(seen.after_service, "giirl_scoring_requests_total", result="ok") > 0

    before = targets(seen.run)["reward-service-0"]
    process = _find(command, "ray::RewardProcess")
    process.kill()
    command.until(recovered, "answers of a new reward service")
    seen.services = [process.pid, _find(command, "ray::RewardProcess").pid]


def _marks(run: Path) -> list[dict[str, Any]]:
    """What the newest checkpoint knows of the actors; the first one is of before they began."""
    checkpoints = run / "checkpoints"
    marks: list[dict[str, Any]] = read_json(checkpoints / (checkpoints / "latest").read_text() / "actors.json")["marks"]
    return marks


def _incarnation(run: Path) -> int:
    """Of the one actor that the newest checkpoint knows."""
    (mark,) = _marks(run)
    assert mark["actor"] == "actor-0"
    return int(mark["incarnation"])


def _find(command: Command, title: str) -> psutil.Process:
    """The process that Ray gave a class's name; it adds that of the method under way."""
    found = [p for p in command.look() if command_line(p)[:1] and command_line(p)[0].startswith(title)]
    assert len(found) == 1, f"{len(found)} processes are {title}"
    return found[0]


def _chrome(actor: psutil.Process) -> psutil.Process:
    """The main process of an actor's Chrome: the one with a profile and no type."""
    for process in actor.children(recursive=True):
        words = command_line(process)
        if any("--user-data-dir=" in word for word in words) and not any("--type=" in word for word in words):
            return process
    raise AssertionError(f"actor {actor.pid} has no Chrome")


class Ask:
    """Queries of one Prometheus."""

    def __init__(self, port: int) -> None:
        self._url = f"http://127.0.0.1:{port}/api/v1/query?"

    def __call__(self, query: str) -> list[dict[str, Any]]:
        try:
            with LOOPBACK.open(self._url + urllib.parse.urlencode({"query": query}), timeout=ANSWER_S) as answer:
                rows: list[dict[str, Any]] = json.load(answer)["data"]["result"]
                return rows
        except (urllib.error.URLError, OSError):
            return []  # it is still starting


@contextmanager
def prometheus(folder: Path) -> Iterator[Ask | None]:
    """A Prometheus that watches the run in `folder`; None on a machine without."""
    program = shutil.which("prometheus")
    if program is None:
        yield None
        return
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    config = folder / "prometheus.yml"
    config.write_text(
        "global: {scrape_interval: 1s}\n"
        "scrape_configs: [{job_name: giirl, file_sd_configs: [{files: [run/prometheus.json]}]}]\n"
    )
    process = subprocess.Popen(
        [
            program,
            f"--config.file={config}",
            f"--storage.tsdb.path={folder / 'tsdb'}",
            f"--web.listen-address=127.0.0.1:{port}",
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield Ask(port)
    finally:
        process.kill()
        process.wait(timeout=GONE_S)
