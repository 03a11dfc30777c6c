"""The state of a run, read from the metrics of its learner; for a run that nobody answers for, from its folder."""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from giirl.run.folder import RunFolder
from giirl.throughput import format_success
from giirl_core.files import is_locked
from giirl_core.progress import duration
from giirl_core.telemetry.prometheus import Samples, parse_samples

TIMEOUT_S = 0.7  # for the learner's answer
DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))
OTHERS_PHASES = {  # of a run whose learner does not answer
    "finished": "finished; its result is in result.json",
    "not running": "not running; to go on: giirl train --resume RUN",
    "silent": "under way, but its learner does not answer; is it on another machine?",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class RunStatus:
    """The state of a run at one moment. What is not known is None or empty."""

    run: str  # as it was asked for
    phase: str  # "demonstrations", "starting", "training", "evaluation", or one of OTHERS_PHASES
    iteration: int = 0  # iterations done
    goal: int | None = None  # iterations after which the training ends
    seconds_left: float | None = None  # of the training, at the recent rate
    success: Mapping[str, float] = field(default_factory=dict)  # by task, over the last training episodes
    flow: Mapping[str, float] = field(default_factory=dict)  # of the last 20 s, as in curve.jsonl
    dropped: Mapping[str, int] = field(default_factory=dict)  # episodes in this session, by reason
    queued: int | None = None  # episodes that wait for the learner
    workers: Mapping[str, Mapping[str, int]] = field(default_factory=dict)  # kind -> state -> processes
    checkpoint_age_s: float | None = None

    def to_json(self) -> str:
        """All fields as a JSON object."""
        return json.dumps(asdict(self), indent=2)


def read_status(run: str) -> RunStatus:
    """The state of a run. `run` is its folder, or the address HOST:PORT of its learner's metrics.

    ValueError if it is neither, or if nobody answers at the address.
    """
    path = Path(run)
    if path.is_dir():
        return _of_folder(path)
    address = run.removeprefix("http://").removesuffix("/").removesuffix("/metrics")
    if ":" not in address or "/" in address:
        raise ValueError(f"there is no run folder {run}: wanted the folder of a run, or HOST:PORT of its metrics")
    samples = _scrape(address)
    if samples is None:
        raise ValueError(f"nobody answers at {address}: the run has ended, or it listens on another address")
    return from_samples(run, samples)


def newest_run() -> str:
    """The folder in runs/ that was changed last; ValueError if there is none."""
    configs = sorted(Path("runs").glob("*/config.json"), key=lambda path: path.parent.stat().st_mtime)
    if not configs:
        raise ValueError("there is no run in runs/: name one, as in giirl status RUN")
    return str(configs[-1].parent)


def from_samples(run: str, samples: Samples) -> RunStatus:
    """The state that a learner's metrics show."""
    phases = [labels["phase"] for labels, value in samples.get("giirl_run_phase", []) if value]
    flow = _by(samples, "giirl_flow", "key")
    iteration, goal = int(_one(samples, "giirl_policy_version") or 0), _one(samples, "giirl_iterations_goal")
    rate, saved_s = flow.get("iterations_per_s"), _one(samples, "giirl_checkpoint_timestamp_seconds")
    lost = _one(samples, "giirl_trajectories_lost_total") or 0.0
    dropped = {**_by(samples, "giirl_trajectories_dropped_total", "reason"), "lost": lost}
    queued = _one(samples, "giirl_trajectories_queued")
    workers: dict[str, dict[str, int]] = {}
    for labels, value in samples.get("giirl_workers", []):
        if value:
            workers.setdefault(labels["kind"], {})[labels["state"]] = int(value)
    return RunStatus(
        run=run,
        phase=phases[0] if phases else "starting",
        iteration=iteration,
        goal=int(goal) if goal else None,
        seconds_left=(goal - iteration) / rate if goal and rate and phases == ["training"] else None,
        success=_by(samples, "giirl_success_ratio", "task"),
        flow=flow,
        dropped={reason: int(count) for reason, count in dropped.items() if count},
        queued=int(queued) if queued is not None else None,
        workers=workers,
        checkpoint_age_s=max(0.0, time.time() - saved_s) if saved_s else None,
    )


def lines(status: RunStatus) -> list[str]:
    """The state as aligned lines for a terminal or a log."""
    phase = OTHERS_PHASES.get(status.phase, status.phase).replace("RUN", status.run)
    of_goal = f" of {status.goal}" if status.goal else ""
    left = f", {duration(status.seconds_left)} left" if status.seconds_left is not None else ""
    found = [(status.run, f"{phase}; iteration {status.iteration}{of_goal}{left}")]
    if status.success:
        found.append(("success", format_success(status.success)))
    if flow := status.flow:
        found.append(("rate", f"{flow['episodes_per_s']:g} episodes/s, {flow['env_steps_per_s']:g} steps/s"))
        found.append(
            (
                "waiting",
                f"the learner for episodes {100 * flow['learner_waits']:.0f} % of its time, "
                f"the actors for the learner {100 * flow['actors_idle']:.0f} %",
            )
        )
        found.append(("lag", f"{flow['lag']:g} versions; {status.queued or 0} episodes in the queue"))
    if status.workers:
        dropped = ", ".join(f"{reason} {count}" for reason, count in status.dropped.items())
        found.append(("dropped", dropped or "nothing"))
    for kind, states in status.workers.items():
        found.append((kind, ", ".join(f"{count} {state.replace('_', ' ')}" for state, count in states.items())))
    if status.checkpoint_age_s is not None:
        found.append(("saved", f"{duration(status.checkpoint_age_s)} ago"))
    width = max(len(name) for name, _ in found[1:]) if len(found) > 1 else 0
    return [": ".join(found[0]), *(f"  {name:{width}}  {text}" for name, text in found[1:])]


def _of_folder(path: Path) -> RunStatus:
    folder, config = RunFolder.open(path)
    if (address := _learner_address(folder)) and (samples := _scrape(address)) is not None:
        return from_samples(str(path), samples)
    points = folder.points()
    last: dict[str, Any] = points[-1] if points else {}
    pointer = folder.checkpoints / "latest"
    phase = "finished" if folder.result.is_file() else "not running"
    return RunStatus(
        run=str(path),
        phase="silent" if is_locked(path) else phase,
        iteration=last.get("step", 0),
        goal=config.iterations,
        checkpoint_age_s=max(0.0, time.time() - pointer.stat().st_mtime) if pointer.is_file() else None,
    )


def _learner_address(folder: RunFolder) -> str:
    """Where the learner's metrics are, from the file for Prometheus; "" if there is none."""
    try:
        groups = json.loads(folder.targets.read_bytes())
        return next((str(g["targets"][0]) for g in groups if g["labels"]["process"] == "learner"), "")
    except (OSError, ValueError, LookupError, TypeError):
        return ""


def _scrape(address: str) -> Samples | None:
    """The metrics at an address; None if nobody answers in time, or it is no learner of GIIRL."""
    try:
        with DIRECT.open(f"http://{address}/metrics", timeout=TIMEOUT_S) as response:
            samples = parse_samples(response.read().decode())
    except (urllib.error.URLError, OSError, ValueError):
        return None
    return samples if "giirl_policy_version" in samples else None


def _one(samples: Samples, name: str) -> float | None:
    return samples[name][0][1] if samples.get(name) else None


def _by(samples: Samples, name: str, label: str) -> dict[str, float]:
    return {labels[label]: value for labels, value in samples.get(name, [])}
