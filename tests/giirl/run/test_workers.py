"""Runs over real sockets with threads as processes: lock-step, changing numbers of actors, several reward services."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from threading import Thread, current_thread, main_thread
from typing import Any

import pytest

import giirl.run.train as giirl_run
from actors.episode_counter import read_counts
from giirl.run.fleet import Fleet
from giirl.run.folder import RunFolder
from giirl.run.workers import WorkersRuntime
from giirl.signals import Stopped
from giirl_core.config_file import dump_config
from giirl_core.nets.parameters import serialise_net
from giirl_core.nets.reward import build_reward
from giirl_core.processes import open_files
from giirl_core.types import Episode
from learner.checkpoint import save_checkpoint
from learner.stream.ingest import Ingest
from reward_service.process import RewardProcess
from tests.giirl.small import config, run
from tests.thread_platform import ThreadCall, ThreadPlatform, ThreadProcess

LOCK_STEP = ("runtime=local", "stream.policy_lag=0", "stream.reward_lag=0", "actors.tabs=2")
WAIT_S = 60.0
FEW = ("iterations=3", "evaluate.episodes=1", "evaluate.random_episodes=1")


@pytest.fixture
def runtimes(monkeypatch: pytest.MonkeyPatch) -> list[WorkersRuntime]:
    """The runtimes that runs open, with threads instead of processes."""
    opened: list[WorkersRuntime] = []

    def open_runtime(config: Any, folder: Any, metrics: Any, stop: Any, resume: Any, save: Any) -> WorkersRuntime:
        opened.append(WorkersRuntime(config, folder, ThreadPlatform(), metrics, stop, resume, save))
        return opened[-1]

    monkeypatch.setattr(giirl_run, "open_runtime", open_runtime)
    return opened


def test_lock_step_over_sockets_gives_the_same_bits_in_any_order_of_arrival(
    runtimes: list[WorkersRuntime], tmp_path: Path
) -> None:
    first = run(tmp_path / "a", *LOCK_STEP, *FEW, "actors.count=2", "scoring.replicas=2")
    second = run(tmp_path / "b", *LOCK_STEP, *FEW, "actors.count=2", "stream.credits=1")
    assert first["parameters_sha256"] == second["parameters_sha256"]
    assert len(runtimes) == 2


@pytest.mark.slow
def test_actors_are_added_and_removed_during_a_run(
    runtimes: list[WorkersRuntime], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = WorkersRuntime.take
    heard: list[list[str]] = []

    def resizing(self: WorkersRuntime, episodes: int) -> list[Episode]:
        wanted = {2: 3, 8: 1, 14: 2}.get(len(heard))
        if wanted:
            folder = RunFolder(tmp_path / "run")
            folder.write(folder.wanted, str(wanted))
        taken = take(self, episodes)
        heard.append(sorted(name for name in self.addresses() if name.startswith("actor")))
        return taken

    monkeypatch.setattr(WorkersRuntime, "take", resizing)
    monkeypatch.setattr("giirl.run.fleet.POLL_S", 0.01)
    monkeypatch.setattr("giirl.run.workers.POLL_S", 0.01)
    run(tmp_path / "run", "runtime=local", "iterations=40", "evaluate.episodes=1", "evaluate.random_episodes=1")
    numbers = [len(names) for names in heard]
    assert (numbers[0], max(numbers)) == (1, 3)
    actors = runtimes[0]._fleet._actors
    assert [actor.name for actor in actors] == ["actor-0", "actor-1"]  # the third was stopped
    assert [actor.restarts for actor in actors] == [0, 0]  # the second was not refused when it came back
    offsets = {actor.actor: actor for actor in runtimes[0]._ingest.snapshot().offsets}
    assert set(offsets) == {"actor-0", "actor-1", "actor-2"}
    counts = {name: read_counts(tmp_path / "run/actors" / f"{name}.count")[-1] for name in offsets}
    admitted = {name: (actor.incarnation, actor.low_watermark) for name, actor in offsets.items()}
    assert admitted == counts  # every episode is accounted for


def test_a_run_that_is_asked_to_stop_saves_before_it_waits_for_anybody(
    runtimes: list[WorkersRuntime], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    events: list[str] = []
    take, save, drain = WorkersRuntime.take, save_checkpoint, Fleet.drain

    def stopping(self: WorkersRuntime, episodes: int) -> list[Episode]:
        events.append("take")
        if events.count("take") == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        return take(self, episodes)

    def saving(folder: Path, step: int, *values: Any, **named: Any) -> Path:
        events.append(f"save {step}")
        return save(folder, step, *values, **named)

    def draining(self: Fleet) -> None:
        events.append("drain")
        drain(self)

    monkeypatch.setattr(WorkersRuntime, "take", stopping)
    monkeypatch.setattr(giirl_run, "save_checkpoint", saving)
    monkeypatch.setattr(Fleet, "drain", draining)
    with pytest.raises(Stopped):
        run(tmp_path / "run", "runtime=local", "iterations=100", "checkpoint_every=100")
    assert events[events.index("take") :] == ["take", "take", "take", "save 2", "drain", "save 2", "drain"]


def test_a_run_waits_for_a_place_longer_than_for_episodes_and_says_so_once(
    runtimes: list[WorkersRuntime],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    begun_s = time.monotonic()
    start = ThreadPlatform.start

    def full() -> bool:
        return time.monotonic() < begun_s + 5

    class Waiting(ThreadCall):
        def done(self) -> bool:
            return not full() and super().done()

    class WaitingProcess(ThreadProcess):
        def placed(self) -> bool:
            return not full()

        def call(self, method: str, *values: Any) -> ThreadCall:
            return Waiting(getattr(self._worker, method), values)

    def start_waiting(self: ThreadPlatform, kind: type[Any], name: str, *values: Any, **how: Any) -> ThreadProcess:
        if name.startswith("actor"):
            return WaitingProcess(kind(*values))
        return start(self, kind, name, *values, **how)

    monkeypatch.setattr(ThreadPlatform, "start", start_waiting)
    monkeypatch.setattr("giirl_core.processes.waiting.PATIENCE_S", 1.0)
    run(tmp_path / "run", "runtime=local", *FEW, "stream.take_timeout_s=2", "actors.count=2", "actors.chrome=1")
    assert time.monotonic() > begun_s + 5
    said = [record.message for record in caplog.records if "place" in record.message]
    assert len(said) == 2
    assert said[0].startswith("actor-0 and 1 more of 3 processes waited ")
    assert "actor-0 asks for 1 CPU, 1000 MB of memory, 1 chrome, free are threads; add a node" in said[0]
    assert said[1].startswith("all processes have a place")


def test_on_a_cluster_connections_are_encrypted_and_no_secret_key_leaves_its_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    carried: list[object] = []  # everything that Ray would carry, in both directions

    def call(self: ThreadProcess, method: str, *values: object) -> ThreadCall:
        made = ThreadCall(getattr(self._worker, method), values)
        carried.extend(values)
        if method == "addresses":
            carried.append(made.result(20.0))
        return made

    def start(self: ThreadPlatform, kind: type[Any], name: str, *values: object, **place: object) -> ThreadProcess:
        carried.extend(values)
        return ThreadProcess(kind(*values))

    def open_runtime(config: Any, folder: Any, metrics: Any, stop: Any, resume: Any, save: Any) -> WorkersRuntime:
        platform = ThreadPlatform(single_node=False)
        return WorkersRuntime(config, folder, platform, metrics, stop, resume, save)

    monkeypatch.setattr(ThreadProcess, "call", call)
    monkeypatch.setattr(ThreadPlatform, "start", start)
    monkeypatch.setattr(giirl_run, "open_runtime", open_runtime)
    result = run(tmp_path / "run", "runtime=local", *FEW, "scoring.replicas=2", "actors.count=2")
    assert result["flow"]["service_reward_share"] > 0
    public, secret = (tmp_path / "run/keys").read_text().split()
    sent = repr(carried)
    assert public in sent
    assert secret not in sent
    assert "Keys(" not in sent
    assert list((tmp_path / f"giirl-{os.getuid()}").iterdir()) == []  # the counts are deleted at the end


def test_rejoin_returns_from_an_idle_reward_service_and_waits_for_a_serving_one(tmp_path: Path) -> None:
    service = RewardProcess(dump_config(config(tmp_path)), "run", "reward-service-0", encrypted=False)
    service.addresses()
    first, second = (
        serialise_net(build_reward(config(tmp_path)).net, 1),
        serialise_net(build_reward(config(tmp_path)).net, 0),
    )
    service.rejoin(first, ())  # returns at once: the caller has to call run
    threads = [Thread(target=service.run, args=(first, ())), Thread(target=service.rejoin, args=(second, ()))]
    threads[0].start()
    while not service._running:
        time.sleep(0.01)
    threads[1].start()
    threads[1].join(0.5)
    assert threads[1].is_alive()  # for as long as it serves
    service.stop()
    for thread in threads:
        thread.join(10)
        assert not thread.is_alive()


def test_the_reward_service_module_imports_neither_torch_nor_the_packages_of_actors() -> None:
    look = "import sys, reward_service.process; print(*{name.split('.')[0] for name in sys.modules})"
    loaded = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, check=True, timeout=60).stdout
    assert not {"torch", "actors", "browser_farm", "learner"} & set(loaded.split())
    assert "reward_service" in loaded.split()


def test_a_learner_that_waits_for_episodes_is_alive(
    runtimes: list[WorkersRuntime], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beats: list[Thread] = []
    monkeypatch.setattr("giirl.run.workers.Ingest.take", lambda self, episodes, timeout_s: waited(timeout_s))
    monkeypatch.setattr("giirl_core.telemetry.health.Health.beat", lambda self: beats.append(current_thread()))

    def waited(timeout_s: float) -> list[Episode]:
        raise TimeoutError

    with pytest.raises(RuntimeError, match="no episode came for 0 s"):
        run(tmp_path / "run", "runtime=local", *FEW, "stream.take_timeout_s=0.2", "actors.count=1")
    assert beats.count(main_thread()) > 1  # the others are of the actor and of the reward service


def test_a_run_goes_on_while_episodes_come_slowly(
    runtimes: list[WorkersRuntime], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, timeout_s, queued = Ingest.take, 0.4, itertools.count(1)

    def slowly(self: Ingest, episodes: int, poll_s: float) -> list[Episode]:
        if time.monotonic() < begun_s + 3 * timeout_s:
            time.sleep(timeout_s / 4)
            raise TimeoutError
        return take(self, episodes, WAIT_S)

    monkeypatch.setattr(Ingest, "take", slowly)
    monkeypatch.setattr(Ingest, "queued", property(lambda self: next(queued)))
    begun_s = time.monotonic()
    run(tmp_path / "run", "runtime=local", *FEW, f"stream.take_timeout_s={timeout_s}")
    assert time.monotonic() > begun_s + 3 * timeout_s


def test_more_actors_than_open_files_allow_are_refused_while_the_run_goes_on(
    runtimes: list[WorkersRuntime], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    take = WorkersRuntime.take

    def growing(self: WorkersRuntime, episodes: int) -> list[Episode]:
        RunFolder(tmp_path / "run").wanted.write_text("1000")
        return take(self, episodes)

    monkeypatch.setattr(WorkersRuntime, "take", growing)
    monkeypatch.setattr("giirl.run.fleet.POLL_S", 0.0)
    monkeypatch.setattr(open_files, "open_files_limit", lambda: 2000)
    run(tmp_path / "run", "runtime=local", *FEW)
    assert len(runtimes[0]._fleet._actors) == 1
    refusals = [record.message for record in caplog.records if "the number of actors stays 1" in record.message]
    assert len(refusals) == 1
    assert "1000 actors need 4512: wanted ulimit -n 4512" in refusals[0]
