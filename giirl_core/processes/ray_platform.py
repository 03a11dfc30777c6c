"""Worker processes as Ray actors: on this machine, or in the Ray cluster that this process was started in.

Ray places and starts the processes and distributes weights: one object for each version, fetched once for each node.
In a cluster the processes outlive the learner for a while (detached actors); a restarted learner finds them by name.
"""

from __future__ import annotations

import hashlib
import logging
import os
import secrets
import signal
import socket
import time
from collections import Counter
from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any

import ray
from ray.exceptions import RayError
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy
from tenacity import retry, retry_if_exception, stop_after_attempt

from giirl_core.config import Config
from giirl_core.config_file import dump_config
from giirl_core.files import short_temporary_folder
from giirl_core.processes.code_version import code_version
from giirl_core.processes.shared_requests import PendingActors, UnfinishedCalls
from giirl_core.processes.supervision import Place, ProcessDied
from giirl_core.processes.waiting import describe_free

NAMESPACE = "giirl"
RESULT_GRACE_S = 10.0  # added to every timeout, for Ray to fetch the result
START_ATTEMPTS = 3  # on a busy machine a node can need longer than the 30 s that Ray waits
DEATH_INFO_TIMEOUT_MS = 100  # how long Ray waits to learn whether a process died or is unreachable; its default is 1 s
DEAD_S = 30.0  # `giirl clean` takes a learner for dead that its processes have not heard of for this long
CONNECT_TIMEOUT_S = 3.0  # to the head of a cluster
ANSWER_TIMEOUT_S = 5.0  # for processes that `giirl clean` asks
QUIET: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
LOGGED = {**QUIET, "log_to_driver": True}  # warnings of the workers: each once, and then how often it came again
THREADS = 16  # of one process: one runs the main loop, the others serve calls


class _RayMixin:
    """The methods of a worker process that depend on Ray."""

    def host(self) -> str:
        return _node_ip()

    def leave(self) -> None:
        """Kill this process; Ray does not restart it."""
        ray.kill(ray.get_runtime_context().current_actor)


class RayCall:
    """A method call in progress in a Ray actor."""

    def __init__(self, ref: Any, unfinished: UnfinishedCalls) -> None:
        self.ref, self._unfinished = ref, unfinished
        unfinished.add(self)

    def done(self) -> bool:
        return self._unfinished.is_done(self)

    def result(self, timeout_s: float) -> Any:
        try:
            return ray.get(self.ref, timeout=timeout_s + RESULT_GRACE_S)
        except RayError as error:
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            raise ProcessDied(lines[-1] if lines else type(error).__name__) from None


class RayProcess:
    """A Ray actor. It is never restarted, so that what an earlier learner left behind cannot come back."""

    def __init__(self, handle: Any, pending: PendingActors, unfinished: UnfinishedCalls, *, reattached: bool) -> None:
        self._handle, self._pending, self._unfinished, self.reattached = handle, pending, unfinished, reattached
        self._created_s, self._placed = time.monotonic(), False

    def placed(self) -> bool:
        self._placed = self._placed or not self._pending.has(self._handle._actor_id.hex(), self._created_s)
        return self._placed

    def call(self, method: str, *values: Any) -> RayCall:
        return RayCall(getattr(self._handle, method).remote(*values), self._unfinished)

    def kill(self) -> None:
        ray.kill(self._handle)


class RayPlatform:
    """Ray: started on this machine for this run alone (runtime `local`), or joined (runtime `ray`).

    On a cluster, processes are found by name: `run/process/version/number`. Those of this run that have another code or
    other settings are killed. Raises RuntimeError when Ray does not start.
    """

    def __init__(self, config: Config, run: str) -> None:
        self.single_node, self._run = config.runtime == "local", run
        sigterm_handler = signal.getsignal(signal.SIGTERM)
        sighup_handler = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # Ray's processes inherit that: they end with us
        try:
            _init(config)
        except Exception as error:
            if type(error) is not Exception:  # Ray raises a plain Exception when its node does not start in time
                raise
            raise RuntimeError(f"Ray did not start, tried {START_ATTEMPTS} times: {error}") from error
        finally:
            signal.signal(signal.SIGTERM, sigterm_handler)  # Ray installs its own, which would end a run unsaved
            signal.signal(signal.SIGHUP, sighup_handler)
        self.node = _node_ip()
        self.host = "127.0.0.1" if self.single_node else self.node
        self._pending, self._unfinished = PendingActors(_pending), UnfinishedCalls(_finished)
        # Processes with other code or other settings are not taken over.
        self._version = f"{code_version()}-{hashlib.sha256(dump_config(config).encode()).hexdigest()[:8]}"
        self._handles: dict[str, Any] = {}  # the newest of each name
        self._left = {} if self.single_node else self._find_left()

    def start(
        self,
        kind: type[Any],
        name: str,
        *values: Any,
        place: Place,
        threads: int = THREADS,
        detached: bool = True,
    ) -> RayProcess:
        if left := self._left.pop(name, None):
            self._handles[name] = left
            return RayProcess(left, self._pending, self._unfinished, reattached=True)
        # Ray pickles this class by value but its bases by name, so a process imports only the module of its `kind`.
        actor_class = type(kind.__name__, (_RayMixin, kind), {})
        options: dict[str, Any] = {"num_cpus": 0, "max_restarts": 0, "max_concurrency": threads}
        if not self.single_node:  # there, all processes share one machine, whatever they need
            options |= {
                "num_cpus": place.cpus,
                "memory": place.memory_bytes or None,
                "resources": dict(place.resources),
                "scheduling_strategy": self._node_apart(name) if place.apart else "SPREAD",
            }
            if detached:
                full_name = f"{self._run}/{name}/{self._version}/{secrets.token_hex(4)}"
                options |= {"name": full_name, "namespace": NAMESPACE, "lifetime": "detached"}
        handle: Any = ray.remote(actor_class).options(**options).remote(*values)
        self._handles[name] = handle
        return RayProcess(handle, self._pending, self._unfinished, reattached=False)

    def share(self, value: Any) -> Any:
        return ray.put(value)

    def resources(self) -> str:
        free, there = ray.available_resources(), ray.cluster_resources()  # type: ignore[no-untyped-call]
        nodes = sum(node["Alive"] for node in ray.nodes())  # type: ignore[no-untyped-call]
        return f"{describe_free(free, there)} on {nodes} node{'s' if nodes != 1 else ''}"

    def end_left(self) -> None:
        """Kill the processes of an earlier session that this one has not taken over."""
        for handle in self._left.values():
            ray.kill(handle)
        self._left.clear()

    def close(self) -> None:
        self.end_left()
        ray.shutdown()

    def _node_apart(self, name: str) -> Any:
        """Prefer the node with the fewest processes of this kind, and not the one where this process was last."""
        kind, nodes = name.rpartition("-")[0], {}
        for other, handle in self._handles.items():
            if other.rpartition("-")[0] == kind:
                nodes[other] = ray._private.state.state.actor_table(handle._actor_id.hex())["Address"]["NodeID"]
        last, used = nodes.pop(name, None), Counter(nodes.values())
        alive = [node for node in ray.nodes() if node["Alive"]]  # type: ignore[no-untyped-call]
        best = min(alive, key=lambda n: (used[n["NodeID"]], n["NodeID"] == last, not n["Resources"].get("CPU")))
        return NodeAffinitySchedulingStrategy(best["NodeID"], soft=True)

    def _find_left(self) -> dict[str, Any]:
        """The processes of this run that an earlier learner left, by name; those of another code are killed."""
        found: dict[str, Any] = {}
        for full_name, handle in _named_actors().get(self._run, {}).items():
            _, name, *version = full_name.split("/")
            if version[:1] == [self._version] and name not in found:
                found[name] = handle
            else:
                ray.kill(handle)
        return found


def kill_left(runs: Collection[str], *, dry_run: bool) -> list[str]:
    """Kill the processes of dead runs in the cluster that this machine belongs to; only of `runs`, if there are any.

    Returns their names. A run is dead when none of its processes has heard of its learner for DEAD_S.
    """
    if not _cluster_answers():
        return []
    _join()
    try:
        found = _named_actors()
        dead = {run for run, handles in found.items() if (run in runs if runs else _silent_s(handles) > DEAD_S)}
        killed = {name: handle for run in dead for name, handle in found[run].items()}
        for handle in killed.values() if not dry_run else ():
            ray.kill(handle)
        return sorted(killed)
    finally:
        ray.shutdown()


def _named_actors() -> dict[str, dict[str, Any]]:
    """The handles of all named actors of GIIRL in the cluster: run -> full name -> handle."""
    found: dict[str, dict[str, Any]] = {}
    for name in ray.util.list_named_actors():
        with suppress(ValueError):  # it has just died
            found.setdefault(name.partition("/")[0], {})[name] = ray.get_actor(name, NAMESPACE)
    return found


def _silent_s(handles: Mapping[str, Any]) -> float:
    """How long the processes of a run have heard of no learner; infinite if none can answer and their job is dead."""
    calls = [handle.silent_s.remote() for handle in handles.values()]
    answered, _ = ray.wait(calls, num_returns=len(calls), timeout=ANSWER_TIMEOUT_S)
    silences = []
    for call in answered:
        with suppress(RayError):
            silences.append(float(ray.get(call)))
    if silences:
        return min(silences)
    table = ray._private.state.state
    jobs = {job["JobID"]: job["IsDead"] for job in table.job_table()}  # type: ignore[no-untyped-call]
    started_by = {table.actor_table(handle._actor_id.hex()).get("JobID", "") for handle in handles.values()}
    return float("inf") if all(jobs.get(job, True) for job in started_by) else 0.0


@retry(
    stop=stop_after_attempt(START_ATTEMPTS),
    retry=retry_if_exception(lambda error: type(error) is Exception),
    before_sleep=lambda state: ray.shutdown(),
    reraise=True,
)
def _init(config: Config) -> None:
    os.environ.setdefault("RAY_timeout_ms_task_wait_for_death_info", str(DEATH_INFO_TIMEOUT_MS))
    os.environ.setdefault("RAY_COLOR_PREFIX", "0")
    if config.runtime == "ray":
        _join(LOGGED)
        return
    if "RAY_AUTH_MODE" not in os.environ:  # with a token in the environment Ray writes none to the disk
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    ray.init(
        address="local",
        num_cpus=max(config.actors.count, os.cpu_count() or 1),
        include_dashboard=False,
        object_store_memory=256 << 20,
        _temp_dir=f"{short_temporary_folder(os.environ.get('RAY_TMPDIR'))}/ray",  # Ray has sockets in it
        **LOGGED,
    )


def _cluster_answers() -> bool:
    """Whether this machine was started as a node of a cluster whose head answers.

    Without this check Ray would wait for minutes, or find the Ray of another run on this machine.
    """
    address = os.environ.get("RAY_ADDRESS") or ray._private.services.find_bootstrap_address(None)
    if not address or address.startswith("http"):
        return bool(address)  # `_join` refuses the address of a dashboard
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_TIMEOUT_S).close()
    except (OSError, ValueError):
        return False
    return True


def _join(logs: Mapping[str, Any] = QUIET) -> None:
    """Join the cluster that this machine belongs to. ConnectionError if it belongs to none."""
    if os.environ.get("RAY_ADDRESS", "").startswith("http"):
        raise ValueError(
            f"RAY_ADDRESS is {os.environ['RAY_ADDRESS']}, the address for submitting jobs: "
            "submit this command with `ray job submit`, or unset RAY_ADDRESS on a node of the cluster"
        )
    ray.init(address="auto", namespace=NAMESPACE, **logs)


def _pending() -> frozenset[str]:
    table = ray._private.state.state.actor_table(None, actor_state_name="PENDING_CREATION")
    return frozenset(key for key, info in table.items() if not info["Pid"])


def _finished(refs: list[Any]) -> list[Any]:
    done: list[Any] = ray.wait(refs, num_returns=len(refs), timeout=0, fetch_local=False)[0]
    return done


def _node_ip() -> str:
    return str(ray.util.get_node_ip_address())  # type: ignore[no-untyped-call]
