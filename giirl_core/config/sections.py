"""The settings of how a run plays, streams and measures, and the types that all settings share.

The docstring below a field is its entry in docs/configuration.md; the unit stands in brackets at its end. After a
change: `python -m giirl_core.config_reference > docs/configuration.md`.
"""

from __future__ import annotations

import os.path
from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
SHOWN = "shown"  # in `net.gestures` and `demos.workflows`: what demonstrations show

MAX_ACTORS = 1024  # the index of an actor is part of its page seeds

Positive = Annotated[int, Field(ge=1)]
Port = Annotated[int, Field(ge=0, le=65535)]
Seconds = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0)]
PositiveFloat = Annotated[float, Field(gt=0)]
Sandbox = Literal["auto", "on", "off"]
Place = Annotated[str, AfterValidator(os.path.expanduser)]  # the path of a file or folder; ~ is the home folder
RewardForm = Literal["logit", "d", "log_d", "gail", "goal"]  # giirl_core/nets/reward.py has the formulas


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class DemosConfig:
    """Where demonstrations come from. Only successful ones are used."""

    source: Literal["scripted", "file", "recordings"] = "scripted"
    """Scripted experts, a file written by `giirl demos`, or a folder of public human recordings."""
    path: Place = ""
    """The demonstration file, or the folder of recordings. Unused with scripted experts."""
    per_task: Positive = 100
    """Largest number of demonstrations of each task. [episodes]"""
    collections: tuple[str, ...] = ()
    """Sub-folders of the recordings to read. Empty reads all of them."""
    scripted_tasks: tuple[str, ...] = ()
    """Tasks that scripted experts demonstrate whatever the source is, say because recordings do not hold the answer."""
    noise_fraction: Share = 0.0
    """Fraction of each task's demonstrations that is replaced by episodes of the random policy."""
    workflows: tuple[str, ...] = (SHOWN,)
    """What exploration follows with `algorithm=wge`, as JSON. `shown` stands for what the demonstrations show."""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class ActorConfig:
    """The processes that play episodes."""

    count: Annotated[int, Field(ge=1, le=MAX_ACTORS)] = 1
    """Number of actors. `giirl actors` changes it during a run. [processes]"""
    min_healthy: Positive = 1
    """The run ends with an error when fewer actors than this are left. [processes]"""
    tabs: Positive = 8
    """Episodes that one actor plays at the same time, each in a tab of one Chrome. [tabs]"""
    open_pages: Annotated[int, Field(ge=0, le=256)] = 0
    """Pages that one actor keeps open in training, while `tabs` of them are played. 0: one for each task, from `tabs`
    to 64. [tabs]"""
    step_delay_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Simulated time of every step, for experiments on pages that respond slowly. [s]"""
    call_timeout_s: Seconds = 10.0
    """Deadline of one call to the browser. [s]"""
    launch_timeout_s: Seconds = 60.0
    """Deadline of starting Chrome. [s]"""
    chrome_sandbox: Sandbox = "auto"
    """Chrome's sandbox, which needs user namespaces. `auto` is `GIIRL_CHROME_SANDBOX`, else `on`, but `off` as root."""
    score_timeout_s: Seconds = 1.0
    """Deadline of one request to a reward service. After a second try the learner computes the rewards. [s]"""
    heartbeat_timeout_s: Seconds = 60.0
    """An actor that sends nothing for this long is replaced. [s]"""
    cpus: Weight = 1.0
    """Cores that an actor asks for on a cluster; `local` asks for nothing. [cores]"""
    memory_mb: Weight = 1000.0
    """Memory that an actor asks for on a cluster. 0 asks for none. [MB]"""
    chrome: Weight = 0.0
    """Units of the resource `chrome` that an actor asks for. A node of a cluster offers some with
    `ray start --resources='{"chrome": 8}'`; where no node does, leave it at 0. [units]"""
    place_timeout_s: Seconds = 24 * 3600.0
    """An actor or reward service for which no node of a cluster has room for this long is given up. [s]"""
    orphan_timeout_s: Annotated[float, Field(ge=10)] = 300.0
    """An actor or reward service that hears nothing of a learner for this long ends itself. A run that is resumed
    before goes on with it. [s]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class ScoringConfig:
    """The reward service, which computes rewards for the actors."""

    replicas: Annotated[int, Field(ge=1, le=64)] = 1
    """Number of reward services. An actor asks the least loaded one. On a cluster they are on different nodes where
    there are enough. [processes]"""
    cpus: Weight = 0.0
    """Cores that a reward service asks for on a cluster. [cores]"""
    memory_mb: Weight = 0.0
    """Memory that a reward service asks for on a cluster. 0 asks for none. [MB]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class StreamConfig:
    """How far actors may run ahead of the learner, and how old a trajectory may be."""

    credits: Annotated[int, Field(ge=1, le=1024)] = 256
    """Most trajectories of one actor that may be played, scored, sent or queued at a time. Flow control allows fewer,
    so that none grows stale. [trajectories]"""
    policy_lag: Annotated[int, Field(ge=0, le=8)] = 4
    """Trajectories of a policy further behind than this are dropped and counted. 0 is lock-step. [versions]"""
    reward_lag: Annotated[int, Field(ge=0, le=8)] = 4
    """Rewards further behind than this are computed again by the learner. [versions]"""
    take_timeout_s: Seconds = 120.0
    """The run ends with an error when it needs a trajectory and the actors send none for this long. [s]"""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class EvaluateConfig:
    """How the result is measured."""

    episodes: Positive = 200
    """Fresh pages of each task for the greedy policy. [episodes]"""
    random_episodes: Positive = 200
    """Fresh pages of each task for the random baseline. [episodes]"""
    agent: Literal["policy", "replay"] = "policy"
    """Who plays: the greedy policy, or, as a baseline, blind replay of the demonstration with the nearest
    instruction."""


@dataclass(config=STRICT, frozen=True, slots=True, kw_only=True)
class MetricsConfig:
    """The Prometheus endpoint of each process."""

    host: str = "127.0.0.1"
    """Address that every process listens on. 0.0.0.0 and :: are all addresses of its machine."""
    port: Port = 0
    """Port of the learner; 0 takes any free one."""
    worker_port: Port = 0
    """Actors and reward services take the first free port from here on; 0 takes any free one."""
