"""Processes by Ray: on this machine, or in the cluster that this process was started in.

Ray places, starts and restarts them and carries weights, one object a version, fetched once a node. In a cluster they
outlive the learner: one that comes back finds them by their names.
"""

from __future__ import annotations

import logging
import os
import secrets
import signal
from typing import Any

import ray
from ray.exceptions import RayError
from tenacity import retry, retry_if_exception, stop_after_attempt

from giirl_core.config import Config
from giirl_core.processes.supervision import Gone

NAMESPACE = "giirl"
ANSWER_S = 10.0
START_TRIES = 3  # on a busy machine its node needs longer than the 30 s that Ray gives it
DEATH_MS = 100  # for Ray to tell a process that ended from one out of reach; it gives itself a second
THREADS = 16  # of a process: one plays, others answer


class _OnRay:
    """What a process knows about the node that Ray put it on."""

    def host(self) -> str:
        return _node()

    def leave(self) -> None:
        """End this process for good."""
        ray.kill(ray.get_runtime_context().current_actor)


class RayCall:
    """A method under way in a Ray actor."""

    def __init__(self, answer: Any) -> None:
        self._answer = answer

    def done(self) -> bool:
        return bool(ray.wait([self._answer], timeout=0)[0])

    def result(self, timeout_s: float) -> Any:
        try:
            return ray.get(self._answer, timeout=timeout_s + ANSWER_S)
        except RayError as error:
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            raise Gone(lines[-1] if lines else type(error).__name__) from None


class RayProcess:
    """A Ray actor that Ray starts again for as long as it is wanted."""

    def __init__(self, handle: Any, *, reattached: bool) -> None:
        self._handle, self.reattached = handle, reattached

    def call(self, method: str, *values: Any) -> RayCall:
        # What is asked while Ray starts the process is answered as soon as that is up. Nothing else may run twice.
        tries = -1 if method == "addresses" else 0
        return RayCall(getattr(self._handle, method).options(max_task_retries=tries).remote(*values))

    def kill(self, *, restart: bool) -> None:
        ray.kill(self._handle, no_restart=not restart)


class RayPlatform:
    """Ray, started here for this run alone, or joined."""

    def __init__(self, config: Config, run: str) -> None:
        self.single_node, self._run = config.runtime == "local", run
        terminated = signal.getsignal(signal.SIGTERM)
        try:
            _init(config)
        except Exception as error:
            if type(error) is not Exception:  # what Ray raises when its node does not come up in time
                raise
            raise RuntimeError(f"Ray did not start, tried {START_TRIES} times: {error}") from error
        signal.signal(signal.SIGTERM, terminated)  # Ray puts its own in place, which ends a run unsaved
        self.host = "127.0.0.1" if self.single_node else _node()

    def start(self, kind: type[Any], name: str, *values: Any, cpus: int, threads: int = THREADS) -> RayProcess:
        full = f"{self._run}/{name}"
        if not self.single_node:
            try:
                return RayProcess(ray.get_actor(full, NAMESPACE), reattached=True)
            except ValueError:
                pass  # nobody has this name yet
        # Ray pickles this class by value and its bases by name, so a process imports the module of its kind alone.
        made = type(kind.__name__, (_OnRay, kind), {})
        options: dict[str, Any] = {"num_cpus": cpus, "max_restarts": -1, "max_concurrency": threads}
        if not self.single_node:
            options |= {"name": full, "namespace": NAMESPACE, "lifetime": "detached"}
        return RayProcess(ray.remote(made).options(**options).remote(*values), reattached=False)

    def share(self, value: Any) -> Any:
        return ray.put(value)

    def resources(self) -> str:
        return str(ray.cluster_resources())  # type: ignore[no-untyped-call]

    def close(self) -> None:
        ray.shutdown()


@retry(
    stop=stop_after_attempt(START_TRIES),
    retry=retry_if_exception(lambda error: type(error) is Exception),
    before_sleep=lambda state: ray.shutdown(),
    reraise=True,
)
def _init(config: Config) -> None:
    os.environ.setdefault("RAY_timeout_ms_task_wait_for_death_info", str(DEATH_MS))
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if config.runtime == "ray":
        ray.init(address="auto", **quiet)
        return
    if "RAY_AUTH_MODE" not in os.environ:  # a key for this run alone, which Ray then does not write to the disk
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    ray.init(
        address="local",
        num_cpus=max(config.actors.count, os.cpu_count() or 1),
        include_dashboard=False,
        object_store_memory=256 << 20,
        **quiet,
    )


def _node() -> str:
    return str(ray.util.get_node_ip_address())  # type: ignore[no-untyped-call]
