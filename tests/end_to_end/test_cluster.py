"""A run as a job on a Ray cluster, submitted as described in deploy/README.md."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.end_to_end.cluster import all_cpus_taken, probe, ray_cluster
from tests.end_to_end.commands import ROOT, Command, curve, find, read_json, run_folder, step
from tests.end_to_end.prometheus import PrometheusQuery, prometheus

pytestmark = [pytest.mark.ray, pytest.mark.timeout(400)]

TINY = """
browser = "fake"
tasks = ["click-test-2"]
iterations = 4
rollout_batch = 4
net = {vectors = "hashed", width = 16}
demos = {per_task = 4}
discriminator = {batch = 8, updates = 1}
policy = {sampled_actions = 4}
evaluate = {episodes = 4, random_episodes = 4}
"""


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with run_folder() as run:
        (run.parent / "tiny.toml").write_text(TINY)
        yield run.parent


@dataclass(frozen=True, slots=True, kw_only=True)
class Cluster:
    """A Ray head with its default settings."""

    head: Command
    job: dict[str, str]  # environment variables of what submits and stops jobs
    driver: dict[str, str]  # of what joins the cluster

    def submit(self, *words: str | Path) -> Command:
        return Command(*words, program=[str(ROOT / "deploy/submit.sh")], env=self.job)

    def stop(self, job: Command) -> None:
        """`ray job stop`: Ray kills the job after 3 seconds."""
        name = re.findall(r"raysubmit_\w+", job.output)[0]
        with Command("job", "stop", name, program=[self.job["RAY"]], env=self.job) as stop:
            assert stop.wait() == 0, stop.output

    def left(self, run: Path) -> list[str]:
        """What a run left on the cluster: processes, Ray actors, CPUs in use, temporary files."""
        found = probe(self.driver)
        identity = (run / "identity").read_text()
        return [
            *(str(p) for title in ("ray::ActorProcess", "ray::RewardProcess") for p in find(self.head, title)),
            *found["actors"],
            *(["a CPU"] if found["cpus_in_use"] else []),
            *map(str, self.head.temporary.glob(f"giirl-*/{identity}")),
        ]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with ray_cluster() as (head, job, driver):
        yield Cluster(head=head, job=job, driver={**driver, "TMPDIR": str(head.temporary)})


def saved(run: Path) -> int:
    """The iteration of the newest checkpoint."""
    return int((run / "checkpoints/latest").read_text().split("-")[1])


def scrapes_all(query: PrometheusQuery | None) -> bool:
    """Whether Prometheus scrapes every process of a run with two actors; True where Prometheus is not installed."""
    processes = {"learner", "actor-0", "actor-1", "reward-service-0"}
    return query is None or {row["metric"]["process"] for row in query("up == 1")} == processes


def test_a_submitted_job_trains_and_writes_its_result_to_the_given_folder(cluster: Cluster, folder: Path) -> None:
    with cluster.submit(folder / "tiny.toml", f"run={folder / 'run'}") as job:
        status = job.wait(timeout_s=150)
        assert status == 0, job.output
    assert step(folder / "run") == 4
    assert read_json(folder / "run/config.json")["runtime"] == "ray"
    assert read_json(folder / "run/result.json")["tasks"]["click-test-2"]["episodes"] == 4
    assert cluster.left(folder / "run") == []


def test_a_stopped_job_goes_on_with_the_same_command_and_leaves_nothing(cluster: Cluster, folder: Path) -> None:
    """`ray job stop` gives a job 3 seconds, Ray's default. Prometheus, where it is installed, scrapes both jobs."""
    run, config = folder / "stopped", folder / "long.toml"
    config.write_text(TINY.replace("iterations = 4", "iterations = 60"))
    words = (config, f"run={run}", "actors.count=2", "actors.step_delay_s=0.2", "--resume-or-start")
    discovery = f"file_sd_configs: [{{files: ['{run / 'prometheus.json'}'], refresh_interval: 1s}}]"
    with prometheus(folder, discovery) as query:
        with cluster.submit(*words) as job:
            job.until(lambda: step(run) > 5, "first iterations", timeout_s=150)
            job.until(lambda: scrapes_all(query), "every process in Prometheus")
            cluster.stop(job)
            job.wait()
            reached = step(run)
            assert reached < 60, job.output
        assert reached - saved(run) <= 1
        with cluster.submit(*words) as job:
            job.until(lambda: step(run) > reached, "next iterations", timeout_s=150)
            job.until(lambda: scrapes_all(query), "every process in Prometheus again")
            assert job.wait(timeout_s=200) == 0, job.output
            assert f"resuming {run} from step-" in job.output
            assert "is given up" not in job.output
    assert [point["step"] for point in curve(run)] == list(range(1, 61))
    assert (run / "result.json").is_file()
    assert cluster.left(run) == []


def test_a_run_waits_for_a_free_cpu_and_says_what_it_needs(cluster: Cluster, folder: Path) -> None:
    run = folder / "patient"
    words = ("train", str(folder / "tiny.toml"), "runtime=ray", f"run={run}", "stream.take_timeout_s=20")
    with all_cpus_taken(cluster.driver) as hog, Command(*words, env=cluster.driver) as command:
        command.until(lambda: "for a place" in command.err, "a line that says what is missing")
        line = next(line for line in command.err.splitlines() if "for a place" in line)
        assert "player-0 asks for 1 CPU, 1000 MB of memory, free are 0 of 2 CPU" in line
        time.sleep(25)  # longer than take_timeout_s
        assert command.process.poll() is None, command.err
        assert step(run) == 0
        hog.process.kill()
        command.until(lambda: step(run) > 0, "first iteration", timeout_s=60)
        assert command.wait() == 0, command.err


def test_giirl_clean_removes_what_a_killed_learner_left(cluster: Cluster, folder: Path) -> None:
    run = folder / "killed"
    words = ("train", str(folder / "tiny.toml"), "runtime=ray", f"run={run}", "iterations=100000")
    with Command(*words, env=cluster.driver) as command:
        command.until(lambda: step(run) > 1, "first iterations", timeout_s=150)
        deadline_s = time.monotonic() + 60  # its episodes may come before it is known to run
        said = ""
        while "actor           1 running" not in said and time.monotonic() < deadline_s:
            with Command("status", run, env=cluster.driver) as status:
                assert status.wait() == 0, status.err
                said = status.out
            assert said.startswith(f"{run}: training; iteration ")
        assert "actor           1 running" in said
        with Command("clean", run, env=cluster.driver) as clean:
            assert clean.wait() == 1
            assert f"{run} is under way: giirl stop {run} first" in clean.err
        command.process.kill()
        command.process.wait()
    assert len(cluster.left(run)) > 3
    with Command("clean", run, env=cluster.driver) as clean:
        assert clean.wait() == 0, clean.err
        assert "removed " in clean.err
    cluster.head.until(lambda: cluster.left(run) == [], "an empty cluster")


def test_a_job_with_an_unknown_setting_fails_with_an_error_message(cluster: Cluster, folder: Path) -> None:
    arguments = ("job", "submit", "--", "giirl", "train", "iteration=4", f"run={folder / 'no'}", "runtime=ray")
    with Command(*arguments, program=[cluster.job["RAY"]], env=cluster.job) as job:
        status = job.wait()
        assert status != 0
        assert "there is no setting 'iteration'" in job.output
    assert not (folder / "no").exists()
