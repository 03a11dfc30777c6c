"""Pages that no browser can play are missing from evaluations and demonstrations: never failures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from giirl.analysis import goal_swap
from giirl.report import inspector
from giirl.run.demonstrations import make
from giirl.run.evaluate import evaluate, result_table
from giirl.run.experts import experts_table, measure
from giirl.run.serial import SerialRuntime
from giirl.statistics import Score
from giirl_core.metrics import Metrics
from giirl_core.nets.parameters import serialise_net
from giirl_core.nets.reward import build_policy, build_reward
from giirl_core.progress import Display
from giirl_core.types import EpisodeSpec
from tests.actors.faulty_farm import FaultyFarm
from tests.giirl.small import config


def index_of(spec: EpisodeSpec) -> int:
    """The number of a page among those of its purpose."""
    return spec.seed & 0xFFFFFFFF


def faulty_farm() -> FaultyFarm:
    """The page with index 0 does not open, the one with index 1 is lost in every step."""
    return FaultyFarm(tabs=2, closed=lambda spec: index_of(spec) == 0, lost=lambda spec: index_of(spec) == 1)


@pytest.fixture
def faulty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let everything that plays pages open a faulty farm."""
    for module in ("actors.player", "giirl.run.experts", "giirl.run.serial"):
        monkeypatch.setattr(f"{module}.open_browser", lambda *_, **__: faulty_farm())


def text(table: Table) -> str:
    console = Console(width=200)
    with console.capture() as captured:
        console.print(table)
    return " ".join(captured.get().split())


def evaluated(path: Path, pages: int) -> dict[str, Any]:
    settings = config(path, "tasks=['click-test']", f"evaluate.episodes={pages}", "evaluate.random_episodes=3")
    row: dict[str, Any] = evaluate(settings, serialise_net(build_policy(settings), 0), Metrics(), Display())[
        "click-test"
    ]
    return row


@pytest.mark.usefixtures("faulty")
def test_pages_that_no_browser_can_play_are_missing_from_an_evaluation_and_no_failures(tmp_path: Path) -> None:
    row = evaluated(tmp_path, 6)
    assert (row["episodes"], row["success"], row["missing"]) == (4, 1.0, 2)
    assert (row["random_episodes"], row["random"]) == (1, 1.0)
    shown = text(result_table({"algorithm": "giirl", "seed": 0, "tasks": {"click-test": row}}))
    assert "Not played, because the browser or the page broke: 2 of 6 pages of click-test." in shown


@pytest.mark.usefixtures("faulty")
def test_a_task_without_a_page_that_can_be_played_has_no_success_rate(tmp_path: Path) -> None:
    row = evaluated(tmp_path, 2)
    assert (row["episodes"], row["success"], row["low"], row["high"], row["missing"]) == (0, None, 0.0, 1.0, 2)
    assert "2 of 2 pages" in text(result_table({"algorithm": "giirl", "seed": 0, "tasks": {"click-test": row}}))


@pytest.mark.usefixtures("faulty")
def test_the_rates_of_the_experts_leave_out_pages_that_no_browser_can_play(tmp_path: Path) -> None:
    settings = config(tmp_path, "tasks=['click-test']")
    (result,) = measure(settings, 6, Metrics(), Display(), {})
    row = result["tasks"]["click-test"]
    assert (row["episodes"], row["success"], row["missing"]) == (4, 1.0, 2)
    assert "2 of 6 pages of click-test" in text(experts_table(result))


@pytest.mark.usefixtures("faulty")
def test_scripted_demonstrations_leave_broken_episodes_out_and_say_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = config(tmp_path, "tasks=['click-test']", "demos.per_task=6")
    made = make(settings, Metrics(), Display())
    assert [episode.trajectory.seed & 0xFFFFFFFF for episode in made] == [2, 3, 4, 5]
    assert all(episode.outcome.success for episode in made)
    assert "2 of 6 pages of click-test" in capsys.readouterr().err


@pytest.mark.usefixtures("faulty")
def test_training_plays_other_pages_instead_of_broken_ones(tmp_path: Path) -> None:
    settings = config(tmp_path, "tasks=['click-test']", "rollout_batch=4")
    runtime = SerialRuntime(settings, Metrics(), None)
    taken = runtime.take(4)
    assert len(taken) >= 4
    assert all(episode.trajectory.seed & 0xFFFFFFFF > 1 and episode.outcome.success for episode in taken)


@pytest.mark.usefixtures("faulty")
def test_a_training_whose_pages_all_break_ends_with_the_reason(tmp_path: Path) -> None:
    settings = config(tmp_path, "tasks=['click-test']", "rollout_batch=1")
    with pytest.raises(RuntimeError, match="no episode of 1 of each task could be played"):
        SerialRuntime(settings, Metrics(), None).take(1)


def test_a_page_that_breaks_in_a_report_has_no_outcome(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspector, "open_browser", lambda *_, **__: FaultyFarm(tabs=1, lost=lambda spec: True))
    settings = config(tmp_path, "tasks=['click-test']", "step_limit=1")
    with inspector.Inspector(settings, serialise_net(build_policy(settings), 0), None, Metrics()) as looks:
        (strip,) = looks.strips("click-test", 1)
    assert (strip.error, strip.outcome) == ("page_hung", None)


def test_a_page_that_does_not_open_in_a_report_or_a_goal_swap_is_an_error_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (inspector, goal_swap):
        monkeypatch.setattr(module, "open_browser", lambda *_, **__: FaultyFarm(tabs=2, closed=lambda spec: True))
    settings = config(tmp_path, "tasks=['click-button']")
    with (
        inspector.Inspector(settings, serialise_net(build_policy(settings), 0), None, Metrics()) as looks,
        pytest.raises(RuntimeError, match="click-button does not open"),
    ):
        next(looks.strips("click-button", 1))
    reward = serialise_net(build_reward(settings).net, 0)
    with pytest.raises(RuntimeError, match="click-button does not open"):
        goal_swap.goal_swap(settings, reward, "click-button", 4, Metrics(), Display())


def test_a_score_without_episodes_has_no_rate() -> None:
    assert Score(episodes=0, successes=0).row() == {"episodes": 0, "success": None, "low": 0.0, "high": 1.0}
