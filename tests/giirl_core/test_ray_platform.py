"""What the Ray platform asks of Ray, with a fake cluster: where processes go, which are taken over and killed."""

from __future__ import annotations

import hashlib
import socket
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from giirl_core.config import Config
from giirl_core.config_file import dump_config
from giirl_core.processes import ray_platform
from giirl_core.processes.code_version import code_version
from giirl_core.processes.ray_platform import RayPlatform, RayProcess, kill_left
from giirl_core.processes.shared_requests import PENDING_POLL_S
from giirl_core.processes.supervision import Place

CONFIG = Config(runtime="ray")
VERSION = f"{code_version()}-{hashlib.sha256(dump_config(CONFIG).encode()).hexdigest()[:8]}"


class Worker:
    """The class that the processes of this test run."""


def node_id(name: str) -> str:
    """An id as Ray wants it: 28 bytes in hex digits."""
    return name.encode().hex().ljust(56, "0")


class FakeRay:
    """A cluster that starts nothing: it remembers what it was asked for."""

    def __init__(self) -> None:
        self.actors: dict[str, dict[str, Any]] = {}  # name -> its row in Ray's table
        self.options: list[dict[str, Any]] = []
        self.killed: list[str] = []
        self.silences: dict[str, float] = {}  # name -> what `silent_s` returns; others do not answer
        self.nodes_up = [self._node(name) for name in ("n1", "n2", "n3")]
        self.dead_jobs = {"01"}
        state = SimpleNamespace(actor_table=self.actor_table, job_table=self.job_table)
        self.head = socket.create_server(("127.0.0.1", 0))
        self.address: str | None = f"127.0.0.1:{self.head.getsockname()[1]}"
        services = SimpleNamespace(find_bootstrap_address=lambda folder: self.address)
        self._private = SimpleNamespace(state=SimpleNamespace(state=state), services=services)
        self.util = SimpleNamespace(list_named_actors=lambda: list(self.actors), get_node_ip_address=lambda: "10.0.0.1")
        self.ObjectRef = str

    @staticmethod
    def _node(name: str, cpus: float = 2.0) -> dict[str, Any]:
        return {"NodeID": node_id(name), "Alive": True, "Resources": {"CPU": cpus}}

    def add(self, name: str, node: str = "n1", *, pid: int = 7, job: str = "01") -> Any:
        self.actors[name] = {"Address": {"NodeID": node}, "Pid": pid, "JobID": job}
        return self.get_actor(name, "giirl")

    def get_actor(self, name: str, namespace: str) -> Any:
        assert namespace == "giirl"
        handle_id = SimpleNamespace(hex=lambda: name)
        silent = SimpleNamespace(remote=lambda: name)
        return SimpleNamespace(name=name, _actor_id=handle_id, silent_s=silent)

    def actor_table(self, name: str | None, actor_state_name: str = "") -> dict[str, Any]:
        if name is not None:
            return self.actors[name]
        assert actor_state_name == "PENDING_CREATION"
        return {name: row for name, row in self.actors.items() if not row["Pid"]}

    def job_table(self) -> list[dict[str, Any]]:
        return [{"JobID": job, "IsDead": job in self.dead_jobs} for job in ("01", "02")]

    def remote(self, kind: type[Any]) -> Any:
        def options(**options: Any) -> Any:
            self.options.append(options)
            strategy = options.get("scheduling_strategy")
            node = strategy.node_id if isinstance(strategy, NodeAffinitySchedulingStrategy) else "n1"
            return SimpleNamespace(remote=lambda *values: self.add(options["name"], node, pid=0))

        return SimpleNamespace(options=options)

    def kill(self, handle: Any) -> None:
        self.killed.append(handle.name)
        self.actors.pop(handle.name, None)

    def nodes(self) -> list[dict[str, Any]]:
        return self.nodes_up

    def wait(self, calls: list[str], num_returns: int, timeout: float) -> tuple[list[str], list[str]]:
        return [name for name in calls if name in self.silences], []

    def get(self, call: str) -> float:
        return self.silences[call]

    def init(self, **options: Any) -> None: ...

    def shutdown(self) -> None: ...

    def available_resources(self) -> dict[str, float]:
        return {"memory": 3e9}

    def cluster_resources(self) -> dict[str, float]:
        return {"CPU": 4.0, "memory": 8e9, "chrome": 8.0, "node:10.0.0.1": 1.0, "object_store_memory": 1e9}


@pytest.fixture
def cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeRay]:
    fake = FakeRay()
    monkeypatch.setattr(ray_platform, "ray", fake)
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    with fake.head:
        yield fake


def platform(run: str = "mine-1") -> RayPlatform:
    return RayPlatform(CONFIG, run)


def test_an_actor_asks_for_cpus_memory_and_chrome_and_is_spread(cluster: FakeRay) -> None:
    place = Place(cpus=1.0, memory_bytes=10**9, resources={"chrome": 1.0})
    process = platform().start(Worker, "actor-0", place=place)
    (options,) = cluster.options
    assert (options["num_cpus"], options["memory"], options["resources"]) == (1.0, 10**9, {"chrome": 1.0})
    assert (options["scheduling_strategy"], options["lifetime"], options["max_restarts"]) == ("SPREAD", "detached", 0)
    assert options["name"].startswith(f"mine-1/actor-0/{VERSION}/")
    assert not process.reattached


def test_replicas_are_on_different_nodes_and_a_new_one_avoids_the_node_that_failed(cluster: FakeRay) -> None:
    cluster.nodes_up[0]["Resources"] = {}  # a node without CPUs is taken last
    ours = platform()
    for index in range(3):
        ours.start(Worker, f"reward-service-{index}", place=Place(apart=True))
    nodes = [options["scheduling_strategy"].node_id for options in cluster.options]
    assert sorted(nodes) == [node_id(name) for name in ("n1", "n2", "n3")]
    assert nodes[2] == node_id("n1")
    cluster.nodes_up.append(cluster._node("n4"))
    for _ in range(2):
        ours.start(Worker, "reward-service-0", place=Place(apart=True))
    assert [options["scheduling_strategy"].node_id for options in cluster.options[-2:]] == [node_id("n4"), nodes[0]]


def test_a_process_has_a_place_when_ray_has_started_it(cluster: FakeRay, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("giirl_core.processes.ray_platform.time.monotonic", lambda: now_s[0])
    ours = platform()
    process = ours.start(Worker, "actor-0", place=Place())
    answers = []
    for pid in (0, 0, 0, 7):
        cluster.actors[cluster.options[0]["name"]]["Pid"] = pid
        answers.append(process.placed())
        now_s[0] += 2 * PENDING_POLL_S
    assert answers == [False, False, False, True]


def test_a_resumed_learner_takes_over_its_processes_but_none_with_other_code_or_settings(cluster: FakeRay) -> None:
    other = VERSION[:9] + "0ther000"
    names = [f"mine-1/actor-0/{VERSION}/a", f"mine-1/actor-1/{other}/b", f"other/actor-0/{VERSION}/c", "mine-1/actor-2"]
    for name in names:
        cluster.add(name)
    ours = platform()
    assert cluster.killed == [names[1], names[3]]
    taken, new = (ours.start(Worker, f"actor-{index}", place=Place()) for index in range(2))
    assert isinstance(taken, RayProcess)
    assert (taken.reattached, new.reattached) == (True, False)
    assert len(cluster.options) == 1


def test_processes_that_a_smaller_session_does_not_use_are_killed_at_its_end(cluster: FakeRay) -> None:
    cluster.add(f"mine-1/actor-7/{VERSION}/a")
    platform().close()
    assert cluster.killed == [f"mine-1/actor-7/{VERSION}/a"]


def test_what_is_free_is_said_with_what_there_is(cluster: FakeRay) -> None:
    cluster.nodes_up.pop()
    assert platform().resources() == "0 of 4 CPU, 0 of 8 chrome, 3000 of 8000 MB of memory on 2 nodes"


def test_only_processes_whose_learner_is_gone_are_cleaned_up(cluster: FakeRay) -> None:
    for name, job in (("dead/actor-0/c/1", "02"), ("living/actor-0/c/1", "02"), ("pending/actor-0/c/1", "01"),
                      ("starting/actor-0/c/1", "02")):  # fmt: skip
        cluster.add(name, job=job)
    cluster.silences = {"dead/actor-0/c/1": ray_platform.DEAD_S + 1, "living/actor-0/c/1": 0.5}
    gone = ["dead/actor-0/c/1", "pending/actor-0/c/1"]
    assert kill_left([], dry_run=True) == gone
    assert cluster.killed == []
    assert kill_left([], dry_run=False) == gone == sorted(cluster.killed)
    assert kill_left(["living"], dry_run=False) == ["living/actor-0/c/1"]


@pytest.mark.parametrize("address", [None, "127.0.0.1:9"])
def test_without_a_cluster_that_answers_there_is_nothing_to_clean_up(cluster: FakeRay, address: str | None) -> None:
    cluster.add("dead/actor-0/c/1")
    cluster.address = address
    assert kill_left([], dry_run=False) == []


def test_the_address_of_the_dashboard_is_refused_in_one_line(cluster: FakeRay, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_ADDRESS", "http://127.0.0.1:8265")
    with pytest.raises(ValueError, match="the address for submitting jobs: submit this command with `ray job submit`"):
        kill_left([], dry_run=True)
