"""Worker processes as Ray actors: on this machine, or in the Ray cluster that this process was started in.

Ray places, starts and restarts the processes and distributes weights: one object for each version, fetched once for
each node. In a cluster the processes outlive the learner (detached actors); a restarted learner finds them by name.
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
from giirl_core.files import short_temporary_folder
from giirl_core.processes.supervision import ProcessDied

NAMESPACE = "giirl"
RESULT_GRACE_S = 10.0  # added to every timeout, for Ray to fetch the result
START_ATTEMPTS = 3  # on a busy machine a node can need longer than the 30 s that Ray waits
DEATH_INFO_TIMEOUT_MS = 100  # how long Ray waits to learn whether a process died or is unreachable; its default is 1 s
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

    def __init__(self, ref: Any) -> None:
        self._ref = ref

    def done(self) -> bool:
        return bool(ray.wait([self._ref], timeout=0)[0])

    def result(self, timeout_s: float) -> Any:
        try:
            return ray.get(self._ref, timeout=timeout_s + RESULT_GRACE_S)
        except RayError as error:
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            raise ProcessDied(lines[-1] if lines else type(error).__name__) from None


class RayProcess:
    """A Ray actor; Ray restarts it whenever it dies, until it is killed with `restart=False`."""

    def __init__(self, handle: Any, *, reattached: bool) -> None:
        self._handle, self.reattached = handle, reattached

    def call(self, method: str, *values: Any) -> RayCall:
        # Ray retries `addresses` until the process has started. No other method may be executed twice.
        retries = -1 if method == "addresses" else 0
        return RayCall(getattr(self._handle, method).options(max_task_retries=retries).remote(*values))

    def kill(self, *, restart: bool) -> None:
        ray.kill(self._handle, no_restart=not restart)


class RayPlatform:
    """Ray: started on this machine for this run alone (runtime `local`), or joined (runtime `ray`).

    Raises RuntimeError when Ray does not start.
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
        self.host = "127.0.0.1" if self.single_node else _node_ip()

    def start(self, kind: type[Any], name: str, *values: Any, cpus: int, threads: int = THREADS) -> RayProcess:
        full_name = f"{self._run}/{name}"
        if not self.single_node:
            try:
                return RayProcess(ray.get_actor(full_name, NAMESPACE), reattached=True)
            except ValueError:
                pass  # no actor has this name yet
        # Ray pickles this class by value but its bases by name, so a process imports only the module of its `kind`.
        actor_class = type(kind.__name__, (_RayMixin, kind), {})
        options: dict[str, Any] = {"num_cpus": cpus, "max_restarts": -1, "max_concurrency": threads}
        if not self.single_node:
            options |= {"name": full_name, "namespace": NAMESPACE, "lifetime": "detached"}
        return RayProcess(ray.remote(actor_class).options(**options).remote(*values), reattached=False)

    def share(self, value: Any) -> Any:
        return ray.put(value)

    def resources(self) -> str:
        return str(ray.cluster_resources())  # type: ignore[no-untyped-call]

    def close(self) -> None:
        ray.shutdown()


@retry(
    stop=stop_after_attempt(START_ATTEMPTS),
    retry=retry_if_exception(lambda error: type(error) is Exception),
    before_sleep=lambda state: ray.shutdown(),
    reraise=True,
)
def _init(config: Config) -> None:
    os.environ.setdefault("RAY_timeout_ms_task_wait_for_death_info", str(DEATH_INFO_TIMEOUT_MS))
    quiet: dict[str, Any] = {"logging_level": logging.ERROR, "log_to_driver": False}
    if config.runtime == "ray":
        ray.init(address="auto", **quiet)
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
        **quiet,
    )


def _node_ip() -> str:
    return str(ray.util.get_node_ip_address())  # type: ignore[no-untyped-call]
