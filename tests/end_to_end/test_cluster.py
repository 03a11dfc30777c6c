"""A run as a job on a Ray cluster, submitted as described in deploy/README.md."""

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
    with ray_cluster() as (_, job_env, _):
        yield job_env


def test_a_submitted_job_trains_and_writes_its_result_to_the_given_folder(
    cluster: dict[str, str], folder: Path
) -> None:
    config = folder / "tiny.toml"
    config.write_text(TINY)
    with Command(config, f"run={folder / 'run'}", program=[str(ROOT / "deploy/submit.sh")], env=cluster) as job:
        status = job.wait(timeout_s=150)
        assert status == 0, job.output
    assert step(folder / "run") == 4
    assert read_json(folder / "run/config.json")["runtime"] == "ray"
    assert read_json(folder / "run/result.json")["tasks"]["click-test-2"]["episodes"] == 4


def test_a_stopped_job_saves_its_run(cluster: dict[str, str], folder: Path) -> None:
    run = folder / "stopped"
    config = folder / "long.toml"
    config.write_text(TINY.replace("iterations = 4", "iterations = 100000"))
    with Command(config, f"run={run}", program=[str(ROOT / "deploy/submit.sh")], env=cluster) as job:
        job.until(lambda: step(run) > 0, "first iteration")
        name = re.findall(r"raysubmit_\w+", job.output)[0]
        with Command("job", "stop", name, program=[cluster["RAY"]], env=cluster) as stop:
            assert stop.wait() == 0, stop.output
        job.wait()
        assert f"stopped and saved; to resume: giirl train --resume {run}" in job.output
    assert (run / "checkpoints/latest").read_text().removesuffix("-again") == f"step-{step(run):08d}"


def test_a_job_with_an_unknown_setting_fails_with_an_error_message(cluster: dict[str, str], folder: Path) -> None:
    arguments = ("job", "submit", "--", "giirl", "train", "iteration=4", f"run={folder / 'no'}", "runtime=ray")
    with Command(*arguments, program=[cluster["RAY"]], env=cluster) as job:
        status = job.wait()
        assert status != 0
        assert "there is no setting 'iteration'" in job.output
    assert not (folder / "no").exists()
