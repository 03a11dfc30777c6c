"""The serial runtime: the same seed gives the same bits, also after a stop, and the page's reward is never used."""

from __future__ import annotations

import re
import shutil
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import giirl.run.serial as serial
import giirl.run.train as giirl_run
from browser_farm.fake import FakeFarm
from giirl.run.evaluate import result_table
from giirl.run.folder import RunFolder
from giirl.run.serial import SerialRuntime
from giirl.signals import Stopped
from giirl_core.types import Command, Episode, Outcome, StepResult
from learner.checkpoint import latest_checkpoint, save_checkpoint
from tests.giirl.small import run

STEPS = 4
PARAMETERS = "parameters_sha256"


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """An uninterrupted run with a checkpoint after every step."""
    path = tmp_path_factory.mktemp("straight") / "run"
    return path, run(path, "checkpoint_every=1", f"keep_checkpoints={STEPS}")


def curve(path: Path) -> list[dict[str, Any]]:
    return [comparable(point) for point in RunFolder(path).points()]


def comparable(result: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in result.items() if name not in ("seconds", "flow")}


def test_the_same_seed_gives_the_same_run_and_another_seed_another(
    straight: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    path, result = straight
    assert comparable(run(tmp_path / "again")) == comparable(result)
    assert curve(tmp_path / "again") == curve(path)
    assert run(tmp_path / "other", "seed=1")[PARAMETERS] != result[PARAMETERS]


def test_a_result_has_counts_and_success_rates(straight: tuple[Path, dict[str, Any]]) -> None:
    path, result = straight
    assert result["training_episodes"] == STEPS * 8
    assert result["env_steps"] == RunFolder(path).points()[-1]["env_steps"] >= STEPS * 8
    assert set(result["demonstrations"].values()) == {4}
    for row in result["tasks"].values():
        assert row["episodes"] == row["random_episodes"] == 4
        assert row["low"] <= row["success"] <= row["high"]
    assert set(result["lowest_last_third"]) == set(result["tasks"])
    assert result_table(result).row_count == 4


@pytest.mark.parametrize("step", [1, 2, STEPS])
def test_resuming_from_any_checkpoint_gives_the_same_bits(
    step: int, straight: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    path, result = straight
    copy = tmp_path / "copy"
    shutil.copytree(path, copy)
    resumed = run(copy, "checkpoint_every=1", resume=copy / f"checkpoints/step-{step:08d}")
    assert comparable(resumed) == comparable(result)
    assert curve(copy) == curve(path)


DEMANDING = (
    "discriminator.gradient_penalty=0.1",
    "discriminator.replay_size=5",
    "policy.bc_warmup_updates=2",
    "policy.prior=clone",
    "policy.frozen_iterations=1",
    "policy.cloning_updates=1",
)


@pytest.mark.parametrize(
    "changes",
    [DEMANDING, ("algorithm=cloning",), ("algorithm=sqil",), ("algorithm=wge", "rollout_batch=32")],
    ids=["giirl", "cloning", "sqil", "wge"],
)
def test_a_run_stopped_by_a_signal_and_resumed_equals_an_uninterrupted_one(
    changes: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = run(tmp_path / "straight", *changes)
    before = signal.getsignal(signal.SIGINT)
    take, calls = SerialRuntime.take, []

    def interrupted(self: SerialRuntime, episodes: int) -> list[Episode]:
        calls.append(episodes)
        if len(calls) == 3:
            signal.raise_signal(signal.SIGINT)
        return take(self, episodes)

    with monkeypatch.context() as patch:
        patch.setattr(SerialRuntime, "take", interrupted)
        with pytest.raises(Stopped):
            run(tmp_path / "stopped", *changes)
    assert signal.getsignal(signal.SIGINT) is before
    checkpoint = latest_checkpoint(tmp_path / "stopped/checkpoints")
    assert checkpoint.name == "step-00000003"  # the current step is finished first
    resumed = run(tmp_path / "stopped", *changes, resume=checkpoint)
    assert comparable(resumed) == comparable(result)


def test_a_second_signal_interrupts_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def impatient(self: SerialRuntime, episodes: int) -> list[Episode]:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGTERM)
        raise AssertionError("the second signal was swallowed")

    monkeypatch.setattr(SerialRuntime, "take", impatient)
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "run")


class NoisyRewards(FakeFarm):
    """A fake browser whose pages return noise as their reward. Everything else is unchanged."""

    def step(self, commands: Mapping[int, Command]) -> dict[int, StepResult]:
        noise = np.random.default_rng(len(commands))
        return {tab: replace(r, raw_reward=float(noise.normal())) for tab, r in super().step(commands).items()}


@pytest.mark.parametrize("algorithm", ["giirl", "cloning"])
def test_the_rewards_of_pages_do_not_affect_training(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = run(tmp_path / "honest", f"algorithm={algorithm}")
    monkeypatch.setattr(serial, "open_browser", lambda config, metrics: NoisyRewards(tabs=config.actors.tabs))
    noisy = run(tmp_path / "noisy", f"algorithm={algorithm}")
    assert noisy[PARAMETERS] == honest[PARAMETERS]
    outcomes = [[point["outcomes"] for point in RunFolder(tmp_path / name).points()] for name in ("honest", "noisy")]
    assert outcomes[0] != outcomes[1]  # the outcomes in the curve do change


def test_changed_outcomes_do_not_affect_training(
    straight: tuple[Path, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = SerialRuntime.take

    def flipped(self: SerialRuntime, episodes: int) -> list[Episode]:
        return [
            replace(episode, outcome=Outcome(raw_reward=1.0 - episode.outcome.raw_reward, ended=False))
            for episode in take(self, episodes)
        ]

    monkeypatch.setattr(SerialRuntime, "take", flipped)
    assert run(tmp_path / "run")[PARAMETERS] == straight[1][PARAMETERS]


def test_changed_discriminator_rewards_do_affect_training(
    straight: tuple[Path, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = SerialRuntime.take

    def generous(self: SerialRuntime, episodes: int) -> list[Episode]:
        return [
            replace(episode, trajectory=replace(episode.trajectory, rewards=episode.trajectory.rewards + 1.0))
            for episode in take(self, episodes)
        ]

    monkeypatch.setattr(SerialRuntime, "take", generous)
    assert run(tmp_path / "run")[PARAMETERS] != straight[1][PARAMETERS]


def test_a_long_iteration_is_saved_at_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved: list[int] = []
    save = save_checkpoint

    def saving(folder: Path, step: int, *values: Any, **named: Any) -> Path:
        saved.append(step)
        return save(folder, step, *values, **named)

    monkeypatch.setattr(giirl_run, "save_checkpoint", saving)
    monkeypatch.setattr(giirl_run, "LONG_ITERATION_S", 0.0)
    run(tmp_path / "run", "checkpoint_every=100")
    assert saved == list(range(STEPS + 1))


def test_training_demonstrations_and_evaluation_never_share_a_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[set[tuple[str, int]]] = []  # what each browser has shown, in the order in which they were opened

    class Watched(FakeFarm):
        def __init__(self, tabs: int) -> None:
            super().__init__(tabs=tabs)
            self._seen: set[tuple[str, int]] = set()
            opened.append(self._seen)

        def reset(self, episodes: Any) -> Any:
            shown = super().reset(episodes)
            self._seen |= {(look.episode.task, look.episode.seed) for look in shown.values()}
            return shown

        def step(self, commands: Any) -> Any:
            results = super().step(commands)
            looks = [result.observation for result in results.values() if result.observation]
            self._seen |= {(look.episode.task, look.episode.seed) for look in looks}
            return results

    for module in ("actors.player", "giirl.run.serial"):
        monkeypatch.setattr(f"{module}.open_browser", lambda config, metrics: Watched(tabs=4))
    run(tmp_path / "run")
    demonstrated, trained, evaluated = opened
    assert len(demonstrated) == 16
    assert len(trained) == STEPS * 8
    assert len(evaluated) == 2 * 16  # of the policy and of the random baseline
    assert not demonstrated & trained
    assert not trained & evaluated
    assert not evaluated & demonstrated


def test_a_checkpoint_of_other_nets_is_an_error_that_names_the_shapes(
    straight: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    path, _ = straight
    for name in ("config.json", "demonstrations.giirl"):
        shutil.copy(path / name, tmp_path)
    with pytest.raises(ValueError, match=r"has shape .* wanted"):
        run(tmp_path, "net.width=8", resume=latest_checkpoint(path / "checkpoints"))


def test_the_progress_of_the_cloned_start_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path / "run", "iterations=1", "policy.bc_warmup_updates=3")
    assert re.search(r"behavioural cloning 3/3 +loss \d+\.\d{3}", capsys.readouterr().err)
