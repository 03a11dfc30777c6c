"""The command, called in this process: success writes the result files, an error is one line and leaves no file."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from giirl_core.files import folder_lock
from giirl_core.wire.messages import read_episodes
from tests.command import Command
from tests.giirl.small import SETTINGS, run


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A finished run."""
    path = tmp_path_factory.mktemp("finished") / "run"
    return path, run(path)


def copy_of(finished: tuple[Path, dict[str, Any]], path: Path) -> Path:
    shutil.copytree(finished[0], path)
    return path


def test_train_writes_its_result_to_the_run_folder_and_to_json(giirl: Command, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("seed = 2\n")
    answer = giirl("train", "mine.toml", *SETTINGS, "run=out", "--json", "copy.json")
    assert answer.status == 0, answer.err
    result = json.loads((tmp_path / "copy.json").read_text())
    assert result == json.loads((tmp_path / "out/result.json").read_text())
    assert {"tasks", "env_steps", "seconds"} <= set(result)
    assert json.loads((tmp_path / "out/config.json").read_text())["seed"] == 2
    assert "click-button" in answer.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["polcy.gamma=0.5"], "nearest is 'policy'"),
        (["policy.gamma=2"], "policy.gamma = 2"),
        (["missing.toml"], "cannot read the config missing.toml"),
        (["broken.toml"], "broken.toml is not valid TOML"),
        (["browser=chrome", 'tasks=["click-buton"]'], "did you mean 'click-button'"),
        (["browser=fake", 'tasks=["click-buton"]'], "it has click-test, click-test-2, click-button"),
        (["demos.source=file"], "demos.path"),
        (["demos.source=file", "demos.path=broken.toml"], "broken.toml is not an episode file"),
        (["demos.source=file", "demos.path=missing.giirl"], "missing.giirl"),
        (["demos.source=recordings", "demos.path=missing"], "missing"),
        (["step_limit=1", 'tasks=["enter-text"]'], "no successful demonstration of 'enter-text'"),
        (["metrics.host=256.0.0.1"], ""),
        (["--json", "missing/a.json"], "cannot write missing/a.json"),
        (["--json", "."], "cannot write ."),
        (["run=broken.toml"], "broken.toml is a file: choose another run=FOLDER"),
        (["run=broken.toml/run"], "broken.toml/run"),
        (["--resume", "out"], "out is not a run"),
    ],
)
def test_an_error_of_train_is_one_line_and_leaves_no_file(
    words: list[str], message: str, giirl: Command, tmp_path: Path
) -> None:
    (tmp_path / "broken.toml").write_text("seed = = 1")
    where = [] if any(word.startswith("run=") for word in words) else ["run=out"]
    first, rest = (words[:1], words[1:]) if words[0].endswith(".toml") else ([], words)
    answer = giirl("train", *first, *SETTINGS, *where, *rest)
    assert message in answer.error
    assert [path.name for path in tmp_path.iterdir()] == ["broken.toml"]


def test_a_corrected_command_can_use_the_same_folder(giirl: Command) -> None:
    words = ("train", *SETTINGS, "iterations=1", "run=out")
    assert giirl(*words, "step_limit=1").status == 1
    assert giirl(*words).status == 0


def test_a_run_that_another_process_uses_cannot_be_resumed(giirl: Command, tmp_path: Path) -> None:
    assert giirl("train", *SETTINGS, "iterations=1", "run=out").status == 0
    with folder_lock(tmp_path / "out"):
        assert "another process uses out" in giirl("train", "--resume", "out", "iterations=2").error
    assert giirl("train", "--resume", "out", "iterations=2").status == 0


def test_a_run_folder_with_files_in_it_is_refused_and_not_changed(giirl: Command, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/thesis.txt").write_text("keep")
    assert "out is not empty: choose another run=FOLDER" in giirl("train", *SETTINGS, "run=out").error
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["thesis.txt"]


def test_an_unknown_option_or_command_ends_with_an_error_and_no_traceback(giirl: Command) -> None:
    for words in (["train", "--runtime", "cloud"], ["trian"], ["train", "--jsno", "x"], ["demos", "stats"]):
        answer = giirl(*words)
        assert answer.status == 2
        assert "Error: " in answer.err
        assert "Traceback" not in answer.err


@pytest.mark.parametrize("words", [["train", "--resume"], ["evaluate"], ["reward", "goal-swap"]])
def test_a_folder_that_is_no_run_is_an_error_with_its_name(words: list[str], giirl: Command, tmp_path: Path) -> None:
    assert "nowhere is not a run: it has no config.json" in giirl(*words, "nowhere").error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [["train", "--resume"], ["evaluate"], ["reward", "goal-swap"]])
def test_a_truncated_checkpoint_is_an_error_that_names_an_older_one(
    words: list[str], giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    path = copy_of(finished, tmp_path / "run")
    net = path / "checkpoints/step-00000004/policy.safetensors"
    net.write_bytes(net.read_bytes()[:1000])
    answer = giirl(*words, path, "--json", "a.json")
    assert "the SHA-256 of policy.safetensors (1000 bytes) is not the" in answer.error
    assert "write step-00000002 into" in answer.error
    assert not (tmp_path / "a.json").exists()
    assert json.loads((path / "config.json").read_text())


def test_resuming_without_its_demonstrations_fails_and_deletes_nothing(
    giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    path = copy_of(finished, tmp_path / "run")
    (path / "demonstrations.giirl").unlink()
    assert "demonstrations.giirl" in giirl("train", "--resume", path).error
    assert (path / "config.json").exists()


def test_ctrl_c_saves_a_checkpoint_and_prints_how_to_resume(
    giirl: Command, finished: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from giirl.run.serial import SerialRuntime

    take = SerialRuntime.take

    def interrupted(self: SerialRuntime, episodes: int) -> Any:
        signal.raise_signal(signal.SIGTERM)
        return take(self, episodes)

    with monkeypatch.context() as patch:
        patch.setattr(SerialRuntime, "take", interrupted)
        answer = giirl("train", *SETTINGS, "run=out")
    assert answer.status == 130
    assert "giirl train --resume out" in answer.err
    assert not (tmp_path / "out/result.json").exists()
    assert giirl("train", "--resume", "out").status == 0
    result = json.loads((tmp_path / "out/result.json").read_text())
    assert result["parameters_sha256"] == finished[1]["parameters_sha256"]
    assert "seed is fixed" in giirl("train", "--resume", "out", "seed=3").error
    assert giirl("train", "--resume", "out", "iterations=9", "evaluate.episodes=2").status == 0
    assert json.loads((tmp_path / "out/curve.jsonl").read_text().splitlines()[-1])["step"] == 9


def test_evaluate_repeats_the_evaluation_of_the_last_checkpoint(
    giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    answer = giirl("evaluate", finished[0], "--json", "a.json")
    assert answer.status == 0, answer.err
    result = json.loads((tmp_path / "a.json").read_text())
    assert result["tasks"] == finished[1]["tasks"]
    assert result["env_steps"] == finished[1]["env_steps"]
    giirl("evaluate", finished[0], "evaluate.episodes=7", "--json", "b.json")
    assert json.loads((tmp_path / "b.json").read_text())["tasks"]["click-test"]["episodes"] == 7


def test_goal_swap_reports_fractions_of_the_requested_number_of_pages(
    giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    assert giirl("reward", "goal-swap", finished[0], "--pages", "9", "--json", "t.json").status == 0
    result = json.loads((tmp_path / "t.json").read_text())
    assert result["pages"] == 9
    assert 0 <= result["own_goal_top1"] <= 1
    assert 0 <= result["swapped_goal_top1"] <= 1
    answer = giirl("reward", "goal-swap", finished[0], "--pages", "2", "--task", "click-test")
    assert "click-test has no page of" in answer.error


def test_demonstrations_made_by_the_command_can_be_counted_and_trained_on(giirl: Command, tmp_path: Path) -> None:
    made = giirl("demos", "make", "--out", "d.giirl", "--per-task", "3", "--browser", "fake")
    assert made.status == 0, made.err
    episodes = read_episodes(tmp_path / "d.giirl")
    assert len(episodes) == 12
    assert all(episode.outcome.success for episode in episodes)
    table = giirl("demos", "stats", "d.giirl").out
    assert "enter-text" in table
    assert "type 3" in " ".join(table.split())
    words = ("demos.source=file", "demos.path=d.giirl", "demos.per_task=2", "iterations=1", "run=out", "--json", "r")
    assert giirl("train", *SETTINGS, *words).status == 0
    assert set(json.loads((tmp_path / "r").read_text())["demonstrations"].values()) == {2}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["stats", "notes.txt"], "notes.txt is not an episode file"),
        (["stats", "missing"], "missing"),
        (["make", "--browser", "fake", "--out", "missing/a"], "cannot write missing/a"),
        (["make", "--browser", "fake", "--out", "a", "--task", "click-buton"], "did you mean 'click-button'"),
        (["make", "--browser", "fake", "--out", "a", "--seed", "70000"], "seed = 70000"),
        (["import", "missing", "--out", "a"], "missing"),
        (["experts", "--task", "click-buton"], "did you mean 'click-button'"),
        (["experts", "--json", "notes.txt", "--resume"], "notes.txt is not a result of giirl demos experts"),
        (["record", "--out", "a"], "there is no screen"),
        (["record", "--out", "a", "--task", "flight.AA"], "flight.AA cannot be recorded"),
    ],
)
def test_an_error_of_demos_is_one_line_and_leaves_no_file(
    words: list[str], message: str, giirl: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    (tmp_path / "notes.txt").write_text("keep")
    assert message in giirl("demos", *words).error
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_version_and_help_succeed(giirl: Command) -> None:
    assert "giirl" in giirl("--version").out
    assert "train" in giirl("--help").out
