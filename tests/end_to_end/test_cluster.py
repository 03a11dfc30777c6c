"""A run as a job of a Ray cluster, submitted as deploy/README.md says."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.end_to_end.cluster import ray_cluster
from tests.end_to_end.commands import ROOT, Command, read_json, run_folder, step

pytestmark = [pytest.mark.ray, pytest.mark.timeout(400)]

TINY = """
browser = "fake"
tasks = ["click-test-2"]
iterations = 4
rollout_batch = 4
net = {vectors = "hashed", width = 16}
demos = {per_task = 4}
evaluate = {episodes = 4, random_episodes = 4}
"""


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with run_folder() as run:
        yield run.parent


@pytest.fixture(scope="module")
def cluster() -> Iterator[dict[str, str]]:
    with ray_cluster() as (_, jobs, _):
        yield jobs


def test_a_submitted_job_trains_and_leaves_its_result_where_it_was_told(cluster: dict[str, str], folder: Path) -> None:
    config = folder / "tiny.toml"
    config.write_text(TINY)
    with Command(config, f"run={folder / 'run'}", program=[str(ROOT / "deploy/submit.sh")], env=cluster) as job:
        status = job.wait(timeout_s=150)
        assert status == 0, job.said
    assert step(folder / "run") == 4
    assert read_json(folder / "run/config.json")["runtime"] == "ray"
    assert read_json(folder / "run/result.json")["tasks"]["click-test-2"]["episodes"] == 4


def test_a_stopped_job_saves_its_run(cluster: dict[str, str], folder: Path) -> None:
    run = folder / "stopped"
    config = folder / "long.toml"
    config.write_text(TINY.replace("iterations = 4", "iterations = 100000"))
    with Command(config, f"run={run}", program=[str(ROOT / "deploy/submit.sh")], env=cluster) as job:
        job.until(lambda: step(run) > 0, "first iteration")
        name = re.findall(r"raysubmit_\w+", job.said)[0]
        with Command("job", "stop", name, program=[cluster["RAY"]], env=cluster) as stop:
            assert stop.wait() == 0, stop.said
        job.wait()
        assert f"stopped and saved; to resume: giirl train --resume {run}" in job.said
    assert (run / "checkpoints/latest").read_text().removesuffix("-again") == f"step-{step(run):08d}"


def test_a_job_with_a_setting_that_does_not_exist_fails_and_says_so(cluster: dict[str, str], folder: Path) -> None:
    words = ("job", "submit", "--", "giirl", "train", "iteration=4", f"run={folder / 'no'}", "runtime=ray")
    with Command(*words, program=[cluster["RAY"]], env=cluster) as job:
        status = job.wait()
        assert status != 0
        assert "there is no setting 'iteration'" in job.said
    assert not (folder / "no").exists()
