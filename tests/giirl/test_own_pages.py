"""Task files in the commands: checked, demonstrated, trained on, evaluated."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from giirl import LearnedReward
from giirl.cli.main import giirl
from giirl_core.wire.messages import read_episodes
from giirl_core.wire.score_client import ScoreClient
from tests.browser_farm.sites.guests import EXPERT, PAGE, SUCCESS, TASK
from tests.giirl.report.test_reward_alone import serving

FEW = ["runtime=serial", "net.vectors=hashed", "net.width=8", "iterations=2", "rollout_batch=2", "step_limit=3"]


@pytest.fixture
def task(tmp_path: Path) -> Path:
    (tmp_path / "guests.html").write_text(PAGE)
    (tmp_path / "experts.py").write_text(EXPERT)
    (tmp_path / "guests.toml").write_text(TASK + SUCCESS)
    return tmp_path / "guests.toml"


def command(*words: str) -> str:
    """The output of a command that succeeds."""
    result = CliRunner().invoke(giirl, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.chrome
@pytest.mark.slow
def test_the_check_of_a_task_file_shows_instructions_and_elements(task: Path, tmp_path: Path) -> None:
    report, shot = tmp_path / "check.json", tmp_path / "page.png"
    output = command("tasks", "check", str(task), "--json", str(report), "--screenshot", str(shot))
    assert output.startswith('Add the guest "')
    found = json.loads(report.read_text())
    assert {"tag": "input_text", "text": "Name", "value": ""} in found["elements"]
    assert (found["left_out"], found["measured"], found["refused"]) == (0, True, {})
    assert [error.split(":")[0] for error in found["failing_scripts"]] == ["success.script"]
    assert "a condition whose script throws does not hold" in output
    assert shot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("guests.toml", "address = 1", "address = 1: "),
        ("click-button", "", "click-button is no task file: wanted NAME.toml"),
        ("nowhere.toml", "", "cannot read the task file"),
    ],
)
def test_a_wrong_task_file_is_one_line(name: str, text: str, message: str, tmp_path: Path) -> None:
    if text:
        (tmp_path / name).write_text(text)
        name = str(tmp_path / name)
    with pytest.raises(ValueError, match=message) as error:
        CliRunner().invoke(giirl, ["tasks", "check", name], catch_exceptions=False, standalone_mode=False)
    assert "\n" not in str(error.value)


@pytest.mark.chrome
@pytest.mark.slow
def test_a_task_file_is_demonstrated_trained_on_evaluated_and_reported(task: Path, tmp_path: Path) -> None:
    demos, run = tmp_path / "demos.giirl", tmp_path / "run"
    command("demos", "make", "--task", str(task), "--per-task", "4", "--out", str(demos))
    episodes = read_episodes(demos)
    assert [episode.outcome.success for episode in episodes] == [True] * 4
    assert all(episode.trajectory.task == str(task) for episode in episodes)
    settings = [f"tasks=['{task}', 'click-test']", f"run={run}", "demos.per_task=4", "evaluate.episodes=4"]
    command("train", *FEW, *settings, "evaluate.random_episodes=2", "actors.tabs=2")
    result = json.loads((run / "result.json").read_text())
    assert result["tasks"].keys() == {str(task), "click-test"}
    assert result["tasks"][str(task)]["episodes"] == 4
    command("report", str(run), "--pages", "1")
    assert "guests.toml" in (run / "report.html").read_text()
    command("reward", "inspect", str(run), "--task", str(task), "--seed", "5")
    command("reward", "score", str(run), str(demos))


@pytest.mark.chrome
@pytest.mark.slow
def test_a_task_without_a_check_of_success_is_trained_and_not_evaluated(task: Path, tmp_path: Path) -> None:
    task.write_text(TASK)
    run = tmp_path / "run"
    output = command("train", *FEW, f"tasks=['{task}']", f"run={run}", "demos.per_task=2", "actors.tabs=1")
    result = json.loads((run / "result.json").read_text())
    assert result["tasks"] == {}
    assert result["training_episodes"] > 0
    assert "not evaluated, since the task file has no [success]" in output


@pytest.mark.chrome
@pytest.mark.ray
@pytest.mark.slow
def test_the_local_runtime_trains_with_a_relative_task_file_and_its_reward_is_served(
    task: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tasks").mkdir()
    for file in (task, task.with_suffix(".html"), task.with_name("experts.py")):
        file.rename(tmp_path / "tasks" / file.name)
    settings = ["tasks=['tasks/guests.toml']", "run=run", "demos.per_task=2", "actors.tabs=2", "evaluate.episodes=2"]
    command("train", *FEW, *settings, "runtime=local", "evaluate.random_episodes=1")
    result = json.loads((tmp_path / "run/result.json").read_text())
    assert result["training_episodes"] >= 4
    assert result["tasks"]["tasks/guests.toml"]["episodes"] == 2
    [episode, *_] = read_episodes(tmp_path / "run/demonstrations.giirl")
    with serving(Path("run")) as (_, address):
        client = ScoreClient([address], identity="test", timeout_s=20.0)
        try:
            [rewards], version = client.score([episode.trajectory])
        finally:
            client.close()
    wanted = LearnedReward("run")
    assert version == wanted.version == 2
    trajectory = episode.trajectory
    own = wanted.score_batch(trajectory.pages, trajectory.actions, [trajectory.goal] * len(trajectory))
    assert rewards.tolist() == pytest.approx(own.tolist(), abs=1e-4)
