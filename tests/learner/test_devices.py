"""Every net and loss on every device that is there; the settings that choose device and threads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from giirl_core.config import Config, DiscriminatorConfig, LearnerConfig, NetConfig, PolicyConfig
from giirl_core.metrics import Metrics
from giirl_core.types import Trajectory
from learner.devices import learner_device, learner_threads
from learner.learner import Learner
from tests.learner.samples import expert_episodes, with_sampled

# Torch makes the CUDA context of the thread that computes gradients when it is first needed, with a warning.
pytestmark = pytest.mark.filterwarnings("ignore:Attempting to run cuBLAS")
DEVICES = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
SMALL = Config(
    runtime="local",
    net=NetConfig(width=16, vectors="hashed"),
    discriminator=DiscriminatorConfig(batch=16, replay_size=6, updates=2, gradient_penalty=0.1),
    policy=PolicyConfig(sampled_actions=4),
)


@pytest.fixture(scope="module")
def demonstrations() -> list[Trajectory]:
    return [episode.trajectory for episode in expert_episodes(3)]


def learner(device: str, demonstrations: list[Trajectory], algorithm: str = "giirl") -> Learner:
    config = replace(SMALL, algorithm=algorithm, learner=LearnerConfig(device=device))  # type: ignore[arg-type]
    return Learner(config, demonstrations, Metrics())


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("form", ["plain", "airl"])
def test_reward_and_policy_learn_on_every_device(device: str, form: str, demonstrations: list[Trajectory]) -> None:
    trained = learner(device, demonstrations)
    trained.discriminator.config = replace(trained.discriminator.config, form=form)  # type: ignore[arg-type]
    before = trained.hash()
    rollouts = trained.featurise([with_sampled(t, trained.policy.net, 4) for t in demonstrations])
    trained.discriminator.update(trained.demos.sample(8), rollouts, trained.policy.net)
    rewards = trained.discriminator.rewards(rollouts, version=1)
    assert {part.device.type for part in rewards} == {"cpu"}
    stats = trained.policy.update(rollouts, rewards)
    trained.cloner.update(trained.demos.sample(8))
    assert trained.hash() != before
    assert all(torch.isfinite(torch.tensor(value)) for value in stats.values())
    assert trained.policy.net.device.type == device


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("form", ["sqil", "iq_learn"])
def test_soft_q_learning_runs_on_every_device(device: str, form: str, demonstrations: list[Trajectory]) -> None:
    trained = learner(device, demonstrations, form)
    rollouts = trained.featurise(demonstrations)
    stats = trained.soft_q.update(trained.demos.sample(8), rollouts)
    assert all(torch.isfinite(torch.tensor(value)) for value in stats.values())


@pytest.mark.parametrize("device", DEVICES)
def test_a_checkpoint_moves_between_devices(device: str, demonstrations: list[Trajectory], tmp_path: Path) -> None:
    one = learner(device, demonstrations)
    one.cloner.update(one.demos.sample(8))
    one.save(tmp_path)
    for other in DEVICES:
        two = learner(other, demonstrations)
        two.load(tmp_path)
        assert two.hash() == one.hash()
        two.cloner.update(two.demos.sample(8))


def test_a_cuda_device_that_is_not_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(ValueError, match=r"learner\.device is 'cuda'.*wanted 'cpu' or 'auto'"):
        learner_device(replace(SMALL, learner=LearnerConfig(device="cuda")))
    assert learner_device(SMALL).type == "cpu"


def test_auto_takes_a_cuda_device_but_serial_stays_on_the_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    assert learner_device(SMALL).type == "cuda"
    assert learner_device(replace(SMALL, runtime="serial")).type == "cpu"


@pytest.mark.parametrize(
    ("runtime", "cores", "actors", "threads"),
    [("serial", 16, 1, 1), ("local", 2, 1, 1), ("local", 16, 3, 10), ("local", 4, 3, 1), ("ray", 16, 50, 16)],
)
def test_threads_are_the_cores_that_actors_leave_free(
    runtime: str, cores: int, actors: int, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda pid: set(range(cores)))
    config = replace(SMALL, runtime=runtime, actors=replace(SMALL.actors, count=actors))  # type: ignore[arg-type]
    assert learner_threads(config) == threads
    assert learner_threads(replace(config, learner=LearnerConfig(threads=3))) == 3
