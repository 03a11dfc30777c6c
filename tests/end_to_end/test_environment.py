"""A local run where the environment belongs to other tools: a proxy, another service's metrics, a long TMPDIR."""

from __future__ import annotations

import pytest

from tests.end_to_end.commands import run_folder, run_giirl

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
