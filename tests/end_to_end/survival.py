"""A run in which one process after the other is killed, and what was observed meanwhile."""

from __future__ import annotations

import json
import signal
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

from tests.end_to_end.commands import (
    Command,
    Sample,
    command_line,
    read_json,
    step,
    targets,
    total,
    try_scrape,
)
from tests.end_to_end.prometheus import prometheus

TASKS = ("click-test-2", "click-button")
ITERATIONS = 250
ARGUMENTS = (
    "train",
    "runtime=local",
    f"tasks={json.dumps(TASKS)}",
    f"iterations={ITERATIONS}",
    "actors.step_delay_s=0.2",  # so that the run outlasts every fault, however fast the machine
    "rollout_batch=8",
    "checkpoint_every=5",
    "demos.per_task=20",
    "evaluate.episodes=20",
    "evaluate.random_episodes=20",
    "actors.score_timeout_s=1.0",
)


@dataclass(slots=True, kw_only=True)
class Survival:
    """What was observed during the run and after it. Processes are named as in the metrics: "actor-0"."""

    run: Path
    status: int = -1
    output: str = ""  # standard output and standard error
    leftover: list[str] = field(default_factory=list)  # processes that outlived the run
    healthy: dict[str, Sample] = field(default_factory=dict)  # process -> its metrics before any fault
    up: dict[str, float] | None = None  # process -> `up`, from a real Prometheus; None if it is not installed
    prometheus_env_steps: float = 0.0  # giirl_env_steps_total, from the same Prometheus
    chrome_kills: int = 0
    after_chrome: Sample = field(default_factory=dict)  # of the actor whose Chrome was killed
    actors: list[int] = field(default_factory=list)  # pids of actor-0, before and after it was killed
    incarnations: list[int] = field(default_factory=list)  # of actor-0, in checkpoints before and after it was killed
    after_actor: Sample = field(default_factory=dict)  # of the new actor-0
    services: list[int] = field(default_factory=list)  # pids of reward-service-0, before and after it was killed
    after_service: Sample = field(default_factory=dict)  # of the new reward-service-0
    learner: Sample = field(default_factory=dict)  # its last metrics


def survive(run: Path) -> Survival:
    """Start the run, kill its processes one after the other, and wait for its end."""
    survival = Survival(run=run)
    with Command(*ARGUMENTS, f"run={run}") as command:
        _observe_healthy(command, survival)
        _kill_chrome(command, survival)
        _kill_actor(command, survival)
        _kill_service(command, survival)
        survival.learner = try_scrape(run, "learner")
        survival.status = command.wait(timeout_s=240)
        survival.output = command.output
        survival.leftover = command.wait_leftover()
    survival.incarnations.append(_incarnation(run))
    return survival


def _observe_healthy(command: Command, survival: Survival) -> None:
    def all_working() -> bool:
        processes = ("learner", "actor-0", "reward-service-0")
        survival.healthy = {process: try_scrape(survival.run, process) for process in processes}
        return (
            all(survival.healthy.values())
            and total(survival.healthy["learner"], "giirl_rewards_used_total", source="service") > 0
        )

    command.until(lambda: step(survival.run) > 0, "first iteration")
    command.until(all_working, "rewards from the service and metrics of every process")
    with prometheus(survival.run.parent, f"file_sd_configs: [{{files: [{survival.run}/prometheus.json]}}]") as query:
        if query:
            survival.up = {}

            def scraped() -> bool:
                survival.up = {row["metric"]["process"]: float(row["value"][1]) for row in query("up")}
                steps = query("sum(giirl_env_steps_total{process='actor-0'})")
                survival.prometheus_env_steps = float(steps[0]["value"][1]) if steps else 0.0
                return sum(survival.up.values()) == 3 and survival.prometheus_env_steps > 0

            command.until(scraped, "scrapes of all three processes by Prometheus", timeout_s=30)


def _kill_chrome(command: Command, survival: Survival) -> None:
    """Kill Chrome until an episode was lost with it: at some moments none is open."""

    def count(name: str, **labels: str) -> float:
        survival.after_chrome = try_scrape(survival.run, "actor-0")
        return total(survival.after_chrome, name, **labels)

    def recovered() -> bool:
        return count("giirl_browser_recoveries_total", cause="browser_died") == survival.chrome_kills

    def played() -> bool:  # the lost episodes are given back once the new Chrome has started
        return count("giirl_env_steps_total") > before + 20

    while not count("giirl_episodes_total", outcome="lost"):
        assert survival.chrome_kills < 10, "no episode was lost with Chrome"
        _chrome(_find(command, "ray::ActorProcess")).send_signal(signal.SIGKILL)
        survival.chrome_kills += 1
        command.until(recovered, "new Chrome")
        before = count("giirl_env_steps_total")
        command.until(played, "steps in the new Chrome")


def _kill_actor(command: Command, survival: Survival) -> None:
    def recovered() -> bool:
        survival.after_actor = (
            try_scrape(survival.run, "actor-0") if targets(survival.run).get("actor-0") != before else {}
        )
        return total(survival.after_actor, "giirl_episodes_total") > 0 and step(survival.run) > reached + 1

    before, reached = targets(survival.run)["actor-0"], step(survival.run)
    command.until(lambda: bool(_actor_offsets(survival.run)), "a checkpoint with the actor")
    survival.incarnations = [_incarnation(survival.run)]
    process = _find(command, "ray::ActorProcess")
    process.kill()
    command.until(recovered, "episodes of a new actor")
    survival.actors = [process.pid, _find(command, "ray::ActorProcess").pid]


def _kill_service(command: Command, survival: Survival) -> None:
    def recovered() -> bool:
        address = targets(survival.run).get("reward-service-0")
        survival.after_service = try_scrape(survival.run, "reward-service-0") if address != before else {}
        return total(survival.after_service, "giirl_scoring_requests_total", result="ok") > 0

    before = targets(survival.run)["reward-service-0"]
    process = _find(command, "ray::RewardProcess")
    process.kill()
    command.until(recovered, "replies of a new reward service")
    survival.services = [process.pid, _find(command, "ray::RewardProcess").pid]


def _actor_offsets(run: Path) -> list[dict[str, Any]]:
    """The actor offsets in the newest checkpoint; the first checkpoint is saved before there are any."""
    checkpoints = run / "checkpoints"
    saved = read_json(checkpoints / (checkpoints / "latest").read_text() / "actors.json")
    offsets: list[dict[str, Any]] = saved["offsets"]
    return offsets


def _incarnation(run: Path) -> int:
    """The incarnation of the only actor in the newest checkpoint."""
    (offsets,) = _actor_offsets(run)
    assert offsets["actor"] == "actor-0"
    return int(offsets["incarnation"])


def _find(command: Command, title: str) -> psutil.Process:
    """The process of a Ray actor class; its title is the class name and the name of the running method."""
    found = [p for p in command.find_descendants() if command_line(p)[:1] and command_line(p)[0].startswith(title)]
    assert len(found) == 1, f"{len(found)} processes have the title {title}, wanted 1"
    return found[0]


def _chrome(actor: psutil.Process) -> psutil.Process:
    """The main process of an actor's Chrome: the one with a profile folder and without a type."""
    for process in actor.children(recursive=True):
        arguments = " ".join(command_line(process))
        if "--user-data-dir=" in arguments and "--type=" not in arguments:
            return process
    raise AssertionError(f"actor {actor.pid} has no Chrome")
