"""From every state of a run's folder either starting or resuming goes on, and each message names the way."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import giirl.run.train as giirl_run
from actors.episode_counter import read_counts
from giirl.run.folder import RunFolder
from giirl.run.states import State, state_of
from giirl.run.workers import WorkersRuntime
from giirl_core.wire.key_file import load_or_create_keys
from tests.command import Command
from tests.giirl.small import SETTINGS, run
from tests.thread_platform import ThreadPlatform

FEW = (*SETTINGS, "iterations=2", "evaluate.episodes=1", "evaluate.random_episodes=1")
Damage = Callable[[Path], None]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A finished run in a folder `out`, and its result."""
    path = tmp_path_factory.mktemp("finished") / "out"
    return path, run(path, *FEW)


def no_checkpoints(path: Path) -> None:
    shutil.rmtree(path / "checkpoints")


def only_a_partial_checkpoint(path: Path) -> None:
    first = path / "checkpoints/step-00000000"
    first.rename(path / "checkpoints/.partial-00000000-ab")
    for name in ("latest", "step-00000002"):
        entry = path / "checkpoints" / name
        shutil.rmtree(entry) if entry.is_dir() else entry.unlink()


def killed_while_it_wrote_its_demonstrations(path: Path) -> None:
    no_checkpoints(path)
    for name in ("curve.jsonl", "demonstrations.giirl", "prometheus.json"):
        (path / name).unlink(missing_ok=True)
    (path / ".demonstrations.giirl.x1").write_bytes(b"giirl epi")


def notes_of_the_user_in_it(path: Path) -> None:
    no_checkpoints(path)
    (path / "notes.txt").write_text("keep")


@pytest.mark.parametrize("way", ["start", "resume"])
@pytest.mark.parametrize(
    "damage",
    [
        no_checkpoints,
        only_a_partial_checkpoint,
        killed_while_it_wrote_its_demonstrations,
        notes_of_the_user_in_it,
    ],
)
def test_a_run_killed_before_its_first_checkpoint_begins_again_either_way(
    damage: Damage, way: str, giirl: Command, tmp_path: Path
) -> None:
    words = ("train", *FEW, "run=out")
    assert giirl(*words).status == 0
    first = json.loads((tmp_path / "out/result.json").read_text())
    (tmp_path / "out/result.json").unlink()
    damage(tmp_path / "out")
    assert state_of(tmp_path / "out") is State.UNSAVED
    answer = giirl(*words) if way == "start" else giirl("train", "--resume", "out")
    assert answer.status == 0, answer.err
    again = json.loads((tmp_path / "out/result.json").read_text())
    assert again["parameters_sha256"] == first["parameters_sha256"]
    assert [path.name for path in (tmp_path / "out").glob(".*")] == []
    if damage is notes_of_the_user_in_it:
        assert (tmp_path / "out/notes.txt").read_text() == "keep"


def test_a_start_killed_while_it_wrote_its_first_file_can_be_repeated(giirl: Command, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/.config.json.ab12").write_text("{")
    assert giirl("train", *FEW, "run=out").status == 0
    assert [path.name for path in (tmp_path / "out").glob(".*")] == []


def test_a_run_with_a_checkpoint_is_never_begun_again_and_the_message_names_the_way(
    giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    shutil.copytree(finished[0], tmp_path / "out")
    error = giirl("train", *FEW, "run=out").error
    assert "choose another run=FOLDER" in error
    words = error.partition(": giirl ")[2].split()
    assert words == ["train", "--resume", "out"]
    assert giirl(*words).status == 0


def test_a_complete_checkpoint_that_latest_does_not_name_yet_is_resumed(
    giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    shutil.copytree(finished[0], tmp_path / "out")
    (tmp_path / "out/checkpoints/latest").unlink()
    assert state_of(tmp_path / "out") is State.SAVED
    answer = giirl("train", "--resume", "out")
    assert answer.status == 0, answer.err
    assert "resuming out from step-00000002" in answer.err


def test_a_config_that_a_person_wrote_is_not_replaced(giirl: Command, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/config.json").write_text('{"seed": 3}')
    assert state_of(tmp_path / "out") is State.FOREIGN
    assert "out is not empty: choose another run=FOLDER" in giirl("train", *FEW, "run=out").error
    assert (tmp_path / "out/config.json").read_text() == '{"seed": 3}'


def damaged_checkpoints(path: Path) -> None:
    for net in path.glob("checkpoints/*/policy.safetensors"):
        net.write_bytes(b"no")


def no_demonstrations(path: Path) -> None:
    (path / "demonstrations.giirl").unlink()


def cut_demonstrations(path: Path) -> None:
    whole = (path / "demonstrations.giirl").read_bytes()
    (path / "demonstrations.giirl").write_bytes(whole[:1000])


@pytest.mark.parametrize("damage", [damaged_checkpoints, no_demonstrations, cut_demonstrations])
def test_the_message_of_a_run_that_cannot_go_on_names_the_command_that_begins_it_anew(
    damage: Damage, giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    shutil.copytree(finished[0], tmp_path / "out")
    damage(tmp_path / "out")
    error = giirl("train", "--resume", "out").error
    assert "Errno" not in error
    words = error.partition("to begin the run anew elsewhere: giirl ")[2].split()
    assert words == ["train", "out/config.json", "run=NEW"]
    assert giirl(*words).status == 0
    assert (tmp_path / "NEW/result.json").exists()


def test_one_unreadable_line_of_the_curve_costs_that_point_alone(
    giirl: Command, finished: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    shutil.copytree(finished[0], tmp_path / "out")
    curve = tmp_path / "out/curve.jsonl"
    first, rest = curve.read_text().split("\n", 1)
    curve.write_bytes(b"\0\0\0\n" + first.encode() + b"\n[1]\n" + rest.encode())
    assert [point["step"] for point in RunFolder(tmp_path / "out").points()] == [1, 2]
    assert giirl("train", "--resume", "out", "iterations=3").status == 0


def test_keys_that_were_cut_off_while_they_were_written_cannot_exist(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(self: Path, target: Path) -> Path:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            load_or_create_keys(tmp_path / "keys")
    keys = load_or_create_keys(tmp_path / "keys")
    assert load_or_create_keys(tmp_path / "keys") == keys
    assert (tmp_path / "keys").stat().st_mode & 0o777 == 0o600


# ---- the clock


def test_a_run_resumes_after_the_clock_was_set_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_runtime(config: Any, folder: Any, metrics: Any, stop: Any, resume: Any, save: Any) -> WorkersRuntime:
        return WorkersRuntime(config, folder, ThreadPlatform(), metrics, stop, resume, save)

    monkeypatch.setattr(giirl_run, "open_runtime", open_runtime)
    local = ("runtime=local", "iterations=2", "keep_checkpoints=9", "stream.take_timeout_s=20")
    path = tmp_path / "run"
    run(path, *FEW, *local)
    counter = path / "actors/actor-0.count"
    before = max(number for number, _ in read_counts(counter))
    now_s = time.time
    monkeypatch.setattr(time, "time", lambda: now_s() - 3600)
    # As after a kill before the second checkpoint: the first one knows no actor yet.
    run(path, *FEW, *local, resume=path / "checkpoints/step-00000000")
    assert max(number for number, _ in read_counts(counter)) > before


def test_no_two_sessions_of_a_run_give_an_actor_the_same_incarnation(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path)
    first = folder.reserve_incarnations(above=0)
    second = RunFolder(tmp_path).reserve_incarnations(above=0)
    assert second > first + 1_000_000
    assert RunFolder(tmp_path).reserve_incarnations(above=1 << 40) > 1 << 40
