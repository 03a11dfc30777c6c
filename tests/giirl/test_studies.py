"""What studies vary: held-out goals, noisy demonstrations, a frozen reward, the environment's reward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch

from giirl.analysis.goal_sensitivity import GoalStep, goal_steps, measure, sensitivity
from giirl.run.folder import RunFolder
from giirl.run.serial import SerialRuntime
from giirl.run.train import reward_of_run
from giirl_core.config import NetConfig
from giirl_core.config_file import load_config
from giirl_core.metrics import Metrics
from giirl_core.nets.models import RewardNet
from giirl_core.nets.reward import RewardModel
from giirl_core.progress import Display
from giirl_core.types import Action, Episode, Goal, Trajectory, Verb, is_held_out
from learner.checkpoint import latest_checkpoint
from learner.learner import Learner
from tests.giirl.small import run
from tests.learner import samples

PARAMETERS = "parameters_sha256"
SHARE = 0.4


def watch_rollouts(monkeypatch: pytest.MonkeyPatch) -> list[Trajectory]:
    """A list that collects every rollout that the learner gets."""
    seen: list[Trajectory] = []
    featurise = Learner.featurise

    def watch(self: Learner, trajectories: Any) -> Any:
        seen.extend(trajectories)
        return featurise(self, trajectories)

    monkeypatch.setattr(Learner, "featurise", watch)
    return seen


def test_held_out_goals_are_neither_demonstrated_nor_trained_on_but_evaluated_separately(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = watch_rollouts(monkeypatch)
    result = run(
        tmp_path / "run",
        'tasks=["click-button", "enter-text"]',
        f"held_out_goals={SHARE}",
        "demos.per_task=12",
        "evaluate.episodes=20",
    )
    shown = [episode.trajectory for episode in RunFolder(tmp_path / "run").load_demonstrations()]
    assert shown
    assert len(seen) >= 4 * 8
    assert not any(is_held_out(trajectory.goal, SHARE) for trajectory in [*shown, *seen])
    for row in result["tasks"].values():
        parts = row["trained_goals"], row["held_out_goals"]
        assert sum(part["episodes"] for part in parts) == row["episodes"] == 20
        assert sum(part["episodes"] * part["success"] for part in parts) == pytest.approx(20 * row["success"])


def test_noisy_demonstrations_replace_that_fraction_of_the_good_ones(tmp_path: Path) -> None:
    run(tmp_path / "good", "demos.per_task=10")
    run(tmp_path / "noisy", "demos.per_task=10", "demos.noise_fraction=0.3")
    good, noisy = (RunFolder(tmp_path / name).load_demonstrations() for name in ("good", "noisy"))
    assert all(episode.outcome.success for episode in good)
    assert len(noisy) == len(good) == 40
    kept = {(e.trajectory.task, e.trajectory.seed) for e in good}
    random = [e for e in noisy if (e.trajectory.task, e.trajectory.seed) not in kept]
    assert len(random) == 4 * 3
    assert not all(episode.outcome.success for episode in random)


def test_training_on_a_frozen_reward_changes_the_policy_and_not_the_reward(tmp_path: Path) -> None:
    first = run(tmp_path / "first")
    again = run(tmp_path / "second", "algorithm=frozen", f"reward_from={tmp_path / 'first'}", "seed=7")
    learned, followed = (
        RunFolder(tmp_path / name).weights(latest_checkpoint(tmp_path / name / "checkpoints"), "reward")
        for name in ("first", "second")
    )
    assert followed.digest == learned.digest
    assert again[PARAMETERS] != first[PARAMETERS]


def test_a_policy_on_a_frozen_reward_can_start_from_a_clone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run(tmp_path / "first")
    frozen = ("algorithm=frozen", f"reward_from={tmp_path / 'first'}", "iterations=1")
    plain = run(tmp_path / "plain", *frozen)
    cloned = run(tmp_path / "cloned", *frozen, "policy.bc_warmup_updates=3", "policy.prior=clone")
    assert "behavioural cloning" in capsys.readouterr().err
    assert cloned[PARAMETERS] != plain[PARAMETERS]
    rewards = [RunFolder(tmp_path / name) for name in ("first", "cloned")]
    first, second = (folder.weights(folder.latest_checkpoint(), "reward") for folder in rewards)
    assert first.digest == second.digest


def test_a_run_without_a_learned_reward_cannot_be_a_frozen_reward(tmp_path: Path) -> None:
    run(tmp_path / "cloned", "algorithm=cloning")
    with pytest.raises(ValueError, match=r"cloned learned no reward: .* 'cloning', wanted giirl or frozen"):
        run(tmp_path / "second", "algorithm=frozen", f"reward_from={tmp_path / 'cloned'}")


@pytest.mark.parametrize("changes", [["algorithm=frozen"], ["reward_from=runs/x"]])
def test_reward_from_is_needed_with_frozen_and_only_then(changes: list[str]) -> None:
    with pytest.raises(ValueError, match="wanted reward_from=RUN with algorithm=frozen"):
        load_config(None, changes)


def test_rollouts_carry_the_page_reward_only_if_the_algorithm_trains_on_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, played = watch_rollouts(monkeypatch), list[Episode]()
    take = SerialRuntime.take

    def watch(self: SerialRuntime, episodes: int) -> list[Episode]:
        played.extend(taken := take(self, episodes))
        return taken

    monkeypatch.setattr(SerialRuntime, "take", watch)
    result = run(
        tmp_path / "true", "algorithm=true_reward", "demos.source=file", "demos.path=none"
    )  # demonstrations are not read
    assert not any(result["demonstrations"].values())
    for episode, trajectory in zip(played, seen, strict=True):
        assert trajectory.rewards[-1] == np.float32(max(episode.outcome.raw_reward, 0.0))
        assert not trajectory.rewards[:-1].any()
    seen.clear()
    played.clear()
    run(tmp_path / "giirl")
    assert all(t.rewards is e.trajectory.rewards for e, t in zip(played, seen, strict=True))


@pytest.mark.parametrize("algorithm", ["sqil", "iq_learn"])
def test_imitation_without_a_reward_gives_the_same_bits_each_time(algorithm: str, tmp_path: Path) -> None:
    first, second = (run(tmp_path / name, f"algorithm={algorithm}") for name in ("one", "two"))
    assert first[PARAMETERS] == second[PARAMETERS]
    assert first["algorithm"] == algorithm


def test_sensitivity_is_measured_for_tasks_with_several_goals_and_its_control_is_a_half(tmp_path: Path) -> None:
    run(tmp_path / "run", "iterations=1")
    config = load_config(tmp_path / "run/config.json")
    found = sensitivity(config, reward_of_run(tmp_path / "run"), 30, Metrics(), Display())
    assert set(found) == {"click-button", "enter-text"}
    for row in found.values():
        assert row["pairs"] >= 20
        assert row["shuffled"] == pytest.approx(0.5, abs=0.2)
        assert not {"trained_goals", "held_out_goals"} & set(row)
    apart = sensitivity(
        replace(config, held_out_goals=SHARE), reward_of_run(tmp_path / "run"), 30, Metrics(), Display()
    )
    for task, row in apart.items():
        groups = [row["trained_goals"], row["held_out_goals"]]
        assert {name: row[name] for name in found[task]} == found[task]
        for unit in ("pairs", "goals"):
            assert sum(group[unit] for group in groups) == row[unit]


def test_the_steps_that_depend_on_the_goal_type_its_words_or_act_on_what_it_names() -> None:
    torch.manual_seed(0)
    config = NetConfig(width=16, gestures=("type text-of", "wait"))
    model = RewardModel(RewardNet(samples.vectors(), config), samples.vectors(), "logit", 5.0)
    shown = samples.page("input_text", "t:Ada", "button:Ok")
    words = Action(verb=Verb.TYPE, element=0, start=1, end=1)
    copied = Action(verb=Verb.TYPE, element=0, literal="Ada")  # also where a goal has the text
    actions = [words, copied, Action(verb=Verb.CLICK, element=2), Action(verb=Verb.WAIT)]
    goals = ('Enter Bea and press "Ok".', "Enter Ada twice.")
    steps = [step for goal in goals for step in goal_steps(samples.trajectory(goal, [shown] * 4, actions))]
    assert [step.action for step in steps] == [words, actions[2], words]
    assert measure(model, steps, 0)["pairs"] == 3


@pytest.mark.parametrize(("reward", "auc"), [(1.0, 1.0), (0.0, 0.5), (-1.0, 0.0)])
def test_sensitivity_is_how_often_the_own_goal_has_the_higher_reward(reward: float, auc: float) -> None:
    shown = samples.page("input_text", "t:Ada", "button:Ok")
    typing = Action(verb=Verb.TYPE, element=0, start=1, end=1)
    goals = [Goal(f"Enter {name}.") for name in ("Ada", "Bea", "Cyd")]
    steps = [GoalStep(shown, typing, goal) for goal in goals]

    class Stub:
        """A reward that is not 0 under the own goal."""

        def score_pairs(self, pages: Any, actions: Any, given: Sequence[Goal]) -> torch.Tensor:
            return torch.tensor([reward * (one == own) for one, own in zip(given, goals, strict=True)])

    found = measure(cast(RewardModel, Stub()), steps, 0)
    assert found == {"auc": auc, "shuffled": 0.5, "pairs": 3, "goals": 3}
