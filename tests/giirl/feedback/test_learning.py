"""The learner reads answers between iterations: they join the demonstrations and the negatives, and nothing else."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from giirl.run.folder import RunFolder
from giirl.run.serial import SerialRuntime
from giirl_core.metrics import Metrics
from giirl_core.types import Action, Episode, Trajectory, Verb
from giirl_core.wire.answers import Answer, write_answer
from learner.data import ExpertSampler
from learner.feedback import Feedback, Heard
from learner.learner import Learner
from tests.giirl.feedback.examples import clicking, typing
from tests.giirl.small import config, run
from tests.learner.samples import vectors

PARAMETERS = "parameters_sha256"
RIGHT = Answer(episode=clicking(1).trajectory)
WRONG = Answer(episode=clicking(2, steps=3).trajectory, wrong_from=1)


@pytest.fixture
def answers(tmp_path: Path) -> Path:
    folder = tmp_path / "feedback"
    folder.mkdir()
    return folder


def feedback(folder: Path, *changes: str) -> Feedback:
    return Feedback(folder, config(folder, *changes), vectors())


def test_answers_become_demonstrations_and_wrong_steps(answers: Path) -> None:
    write_answer(answers, RIGHT)
    write_answer(answers, WRONG)
    heard = feedback(answers).read()
    assert heard is not None
    assert [len(example.features) for example in heard.demonstrations] == [2]
    assert len(heard.wrong) == 2


def test_they_are_read_again_only_when_something_has_changed(answers: Path) -> None:
    reader = feedback(answers)
    assert reader.read() is None  # nothing is there
    path = write_answer(answers, RIGHT)
    assert reader.read() is not None
    assert reader.read() is None
    write_answer(answers, Answer(episode=RIGHT.episode, wrong_from=1))  # the person changes it
    heard = reader.read()
    assert heard is not None
    assert (len(heard.demonstrations), len(heard.wrong)) == (0, 1)
    path.unlink()
    heard = reader.read()
    assert heard is not None
    assert len(heard.demonstrations) == len(heard.wrong) == len(reader) == 0


def test_an_answer_with_a_gesture_that_the_run_does_not_learn_is_left_out(
    answers: Path, caplog: pytest.LogCaptureFixture
) -> None:
    drag = Action(verb=Verb.DRAG, element=0, to=1)
    shown = replace(RIGHT.episode, actions=(drag,) * len(RIGHT.episode))
    write_answer(answers, Answer(episode=RIGHT.episode, wrong_from=0, shown=shown))
    assert feedback(answers).read() == Heard()
    assert "step 0 is DRAG '' on element 0: no gesture that the nets learn" in caplog.text
    heard = feedback(answers, 'net.gestures=["drag to"]').read()
    assert heard is not None
    assert len(heard.demonstrations) == 1


def test_a_folder_that_does_not_exist_has_no_answer(tmp_path: Path) -> None:
    assert feedback(tmp_path / "none").read() is None


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda path: path.write_bytes(path.read_bytes()[:-9]), "is no answer, or it is damaged"),
        (lambda path: path.write_text("{}"), "is no answer, or it is damaged"),
        (lambda path: (path.unlink(), path.mkdir()), "Is a directory"),
    ],
    ids=["cut", "other", "folder"],
)
def test_a_file_that_is_no_answer_is_one_warning(
    spoil: Callable[[Path], object], message: str, answers: Path, caplog: pytest.LogCaptureFixture
) -> None:
    spoil(write_answer(answers, RIGHT))
    write_answer(answers, WRONG)
    reader = feedback(answers)
    with caplog.at_level(logging.WARNING):
        heard = reader.read()
        assert reader.read() is None
    assert heard is not None
    assert (len(heard.demonstrations), len(heard.wrong), len(reader)) == (0, 2, 1)
    assert len(caplog.messages) == 1
    assert message in caplog.messages[0]


def test_answers_of_another_task_or_with_a_held_out_instruction_are_left_out(
    answers: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_answer(answers, RIGHT)
    reader = feedback(answers, 'tasks=["click-test"]')
    assert reader.read() is not None
    assert len(reader) == 0
    assert "which is no task of this run" in caplog.text
    reader = feedback(answers, "held_out_goals=0.999")
    assert reader.read() is not None
    assert len(reader) == 0
    assert "which is held out of training" in caplog.text


def test_demonstrations_of_people_join_those_of_the_run_and_can_leave_again() -> None:
    own, theirs = clicking(1).trajectory, clicking(2).trajectory
    demos = ExpertSampler([own], vectors(), np.random.default_rng(0))
    learner_view = Learner(config(Path("unused")), [theirs], Metrics()).featurise([theirs])
    demos.join(learner_view)
    assert {example.trajectory.seed for example in demos.sample(40)} == {1, 2}
    demos.join(())
    assert {example.trajectory.seed for example in demos.sample(40)} == {1}


def test_steps_that_people_mark_are_negatives_of_the_discriminator(answers: Path) -> None:
    def accuracy(*changes: str) -> dict[str, float]:
        learner = Learner(config(answers, *changes), [typing(3).trajectory], Metrics())
        heard = feedback(answers).read()
        assert heard is not None
        learner.hear(heard)
        rollouts = learner.featurise([clicking(4).trajectory])
        for _ in range(30):
            stats = learner.discriminator.update(learner.demos.sample(4), rollouts, learner.policy.net)
        return stats

    write_answer(answers, WRONG)
    assert accuracy()["d_accuracy_feedback"] == 1.0
    assert "d_accuracy_feedback" not in accuracy("discriminator.feedback=0")


def answer_after(step: int, monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    """A person who judges an episode of the fake browser's pages while the `step`-th batch is played."""
    take, calls = SerialRuntime.take, [0]

    def judged(self: SerialRuntime, episodes: int) -> list[Episode]:
        played = take(self, episodes)
        calls[0] += 1
        if calls[0] == step:
            (path / "feedback").mkdir()
            for number, wrong_from in ((0, -1), (1, 0), (2, 0)):
                trajectory: Trajectory = played[number].trajectory
                write_answer(path / "feedback", Answer(episode=trajectory, wrong_from=wrong_from))
        return played

    monkeypatch.setattr(SerialRuntime, "take", judged)


def comparable(result: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in result.items() if name not in ("seconds", "flow")}


def test_a_run_under_way_learns_from_answers_and_resumes_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone = run(tmp_path / "alone")
    answer_after(2, monkeypatch, tmp_path / "judged")
    settings = ("checkpoint_every=1", "keep_checkpoints=9")
    judged = run(tmp_path / "judged", *settings)
    assert judged[PARAMETERS] != alone[PARAMETERS]
    points = RunFolder(tmp_path / "judged").points()
    assert ["d_accuracy_feedback" in point for point in points] == [False, False, True, True]
    monkeypatch.undo()
    for step in (2, 3):
        copy = tmp_path / f"copy-{step}"
        shutil.copytree(tmp_path / "judged", copy)
        resumed = run(copy, *settings, resume=copy / f"checkpoints/step-{step:08d}")
        assert comparable(resumed) == comparable(judged)


def test_a_damaged_answer_does_not_end_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_after(1, monkeypatch, tmp_path / "run")
    take = SerialRuntime.take

    def spoiled(self: SerialRuntime, episodes: int) -> list[Episode]:
        played = take(self, episodes)
        for path in (tmp_path / "run/feedback").iterdir():
            path.write_bytes(b"nonsense")
        return played

    monkeypatch.setattr(SerialRuntime, "take", spoiled)
    assert run(tmp_path / "run")[PARAMETERS] == run_alone(tmp_path, monkeypatch)[PARAMETERS]


def run_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    monkeypatch.undo()
    return run(tmp_path / "alone")
