"""Ray where the environment belongs to other tools, and where Ray ends the children of its workers in other ways."""

from __future__ import annotations

import sys

import pytest

from tests.end_to_end.commands import ROOT, Command, run_folder, run_giirl

pytestmark = [pytest.mark.ray, pytest.mark.slow, pytest.mark.timeout(400)]

CLOSED = "http://127.0.0.1:1"  # nothing listens there
WORDS = (
    "train",
    "runtime=local",
    "browser=fake",
    'tasks=["click-test"]',
    "iterations=2",
    "rollout_batch=4",
    "demos.per_task=4",
    "evaluate.episodes=4",
    "evaluate.random_episodes=4",
    "net.vectors=hashed",
    "net.width=16",
)


def test_a_local_run_is_not_disturbed_by_proxies_metrics_of_another_service_or_a_long_folder_for_temporary_files() -> (
    None
):
    with run_folder() as run:
        long = run.parent / ("t" * 72)
        long.mkdir()
        environment = {
            "TMPDIR": str(long),
            "PROMETHEUS_MULTIPROC_DIR": str(run.parent / "missing"),
            **dict.fromkeys(("http_proxy", "HTTP_PROXY", "https_proxy", "HTTPS_PROXY", "all_proxy"), CLOSED),
            "RAY_worker_niceness": "0",
        }
        status, output, _ = run_giirl(*WORDS, f"run={run}", env=environment, timeout_s=300.0)
        assert status == 0, output
        assert (run / "result.json").is_file()


KILLED_WORKER = """
import os, signal, sys, time
from pathlib import Path
import ray
from browser_farm.chrome import reaper

class Worker:
    def open(self):
        from browser_farm.farm import ChromeFarm
        self.farm = ChromeFarm(tabs=1)
        return self.farm.chrome_directory, os.getpid()

ray.init(address="local", num_cpus=1, include_dashboard=False, logging_level="ERROR", log_to_driver=False)
directory, pid = ray.get(ray.remote(max_restarts=0)(Worker).remote().open.remote(), timeout=120)
started = len(reaper.processes(Path(directory)))
os.kill(pid, signal.SIGKILL)
deadline = time.monotonic() + 60
while (reaper.processes(Path(directory)) or Path(directory).exists()) and time.monotonic() < deadline:
    time.sleep(0.1)
print(started > 3, len(reaper.processes(Path(directory))), Path(directory).exists(), flush=True)
ray.shutdown()
"""


@pytest.mark.chrome
@pytest.mark.parametrize(
    "policy",
    [
        {},
        {"RAY_kill_child_processes_on_worker_exit": "false"},
        {"RAY_kill_child_processes_on_worker_exit_with_raylet_subreaper": "true"},
        {"RAY_process_group_cleanup_enabled": "true"},
    ],
    ids=["default", "none", "subreaper", "process groups"],
)
def test_chrome_does_not_outlive_a_killed_ray_worker_however_ray_ends_the_children_of_workers(
    policy: dict[str, str],
) -> None:
    """The policies are those of the versions of Ray before, now and to come."""
    program = [sys.executable, "-c", KILLED_WORKER]
    with Command(program=program, env={"RAY_USAGE_STATS_ENABLED": "0", "PYTHONPATH": str(ROOT), **policy}) as command:
        assert command.wait(timeout_s=300.0) == 0, command.output
        assert command.out.splitlines()[-1] == "True 0 False"
