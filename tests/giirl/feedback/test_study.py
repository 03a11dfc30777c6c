"""The study of what answers are worth, with the fake browser: the simulated person, and the budgets of every arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from giirl.feedback.desk import Desk
from giirl.feedback.selector import Candidate
from giirl.run.folder import RunFolder
from giirl.studies import feedback
from giirl.studies.feedback import ARMS, SimulatedPerson, feedback_study, feedback_table
from giirl_core.progress import Display
from giirl_core.types import Outcome, Trajectory
from giirl_core.wire.answers import RIGHT, read_answer
from tests.giirl.feedback.examples import clicking
from tests.giirl.small import SETTINGS

SMALL = (*SETTINGS, 'tasks=["click-button", "enter-text"]', "demos.per_task=3", "iterations=2")


def candidate(seed: int, success: bool) -> Candidate:
    one = clicking(seed)
    outcome = Outcome(raw_reward=1.0 if success else -1.0, ended=True)
    return type(one)(
        view=type(one.view)(task=one.view.task, seed=seed, frames=one.view.frames, outcome=outcome),
        trajectory=one.trajectory,
        doubts=one.doubts,
    )


def wrong_verdicts(tmp_path: Path, mistakes: float) -> int:
    """How often a simulated person answers against the page's verdict, of 200 episodes."""
    desk, person = Desk(tmp_path / "feedback"), SimulatedPerson(mistakes, np.random.default_rng(1))
    wrong = 0
    for seed in range(200):
        one = candidate(seed, success=seed % 2 == 0)
        desk.offer([one])
        assert desk.take("w") is one
        person.answer(desk, one)
        wrong += (read_answer(tmp_path / "feedback" / one.key).wrong_from == RIGHT) != (seed % 2 == 0)
    return wrong


def test_the_simulated_person_follows_the_page_but_for_its_mistakes(tmp_path: Path) -> None:
    assert wrong_verdicts(tmp_path, 0.0) == 0
    assert 2 <= wrong_verdicts(tmp_path, 0.05) <= 20


def test_it_shows_the_right_way_of_what_it_calls_wrong(tmp_path: Path) -> None:
    way: Trajectory = clicking(2, steps=1).trajectory
    desk, person = Desk(tmp_path / "feedback"), SimulatedPerson(0.0, np.random.default_rng(1), lambda one: way)
    for one in (candidate(1, success=True), candidate(2, success=False)):
        desk.offer([one])
        assert desk.take("w") is one
        person.answer(desk, one)
    shown = [read_answer(path).shown for path in sorted((tmp_path / "feedback").iterdir())]
    assert [one is not None for one in shown] == [False, True]


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    root = tmp_path_factory.mktemp("studies")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(feedback, "BUDGETS", (4, 6))
        patch.setattr(feedback, "ITERATIONS", 1)
        return root, feedback_study(range(1), root, SMALL, Display())


def test_every_arm_starts_from_the_same_run_and_gets_as_much(studied: tuple[Path, dict[str, Any]]) -> None:
    root, result = studied
    assert list(result["arms"]) == [arm.name for arm in ARMS]
    for rows in result["arms"].values():
        assert [row["given"] for row in rows] == [0, 4, 6]
        assert rows[0] == result["arms"]["no answers"][0]
        assert rows[0]["episodes"] == 8
    (place,) = root.iterdir()
    folders = [RunFolder(place / f"seed-0-{number}") for number in range(len(ARMS))]
    assert [len(list(one.feedback.glob("*"))) for one in folders] == [0, 6, 6, 0]
    assert [len(one.load_demonstrations()) for one in folders] == [6, 6, 6, 12]
    assert all(one.points()[-1]["step"] == 4 for one in folders)
    assert feedback_table(result).row_count == len(ARMS) * 3


def test_what_is_measured_is_not_repeated(
    studied: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    root, result = studied
    monkeypatch.setattr(feedback, "BUDGETS", (4, 6))
    monkeypatch.setattr(feedback, "ITERATIONS", 1)
    monkeypatch.delattr(feedback, "train")
    assert feedback_study(range(1), root, SMALL, Display()) == result


def test_no_answer_holds_the_verdict_of_the_page(studied: tuple[Path, dict[str, Any]]) -> None:
    root, _ = studied
    for path in root.glob("*/seed-0-1/feedback/*.answer"):
        content = path.read_bytes()
        assert b"raw_reward" not in content
        assert b"ended" not in content
