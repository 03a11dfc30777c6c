"""Results are saved before they are printed, and one bad thing among many costs itself alone."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import giirl.cli.bench as bench
from giirl.cli.reproduce_web import commands
from giirl_core.progress import Display
from giirl_core.types import NO_SPAN, Verb
from giirl_core.wire.messages import read_episodes, write_episodes
from tests.browser_farm.human.recording_builder import enter_text_recording
from tests.command import Command
from tests.giirl.small import SETTINGS, run

# ---- saved before printed


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run."""
    path = tmp_path_factory.mktemp("finished") / "run"
    run(path)
    return path


@pytest.fixture
def closed_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing can be printed to standard output, as after `| true`."""

    def broken(*words: object, **options: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(Display, "table", broken)
    echo = click.echo

    def only_errors(text: object = None, *, err: bool = False) -> None:
        if not err:
            raise BrokenPipeError
        echo(text, err=err)

    monkeypatch.setattr(click, "echo", only_errors)


MEASURED = ("steps_per_s", "cpu_ms_per_step", "steps_per_core_second", "ratio_miniwob", "ratio_miniwob_no_screenshot")
FOUND = {"tasks": {"click-test": dict.fromkeys(MEASURED, 1.0)}, "memory": {"environment": 1}}


@pytest.mark.usefixtures("closed_pipe")
@pytest.mark.parametrize(
    "words",
    [
        ("train", *SETTINGS, "iterations=1", "run=out"),
        ("evaluate", "RUN"),
        ("reward", "goal-swap", "RUN", "--pages", "2"),
        ("reward", "score", "RUN", "RUN/demonstrations.giirl"),
        ("demos", "import", "recordings", "--out", "d.giirl"),
        ("bench", "farm"),
        ("bench", "learner"),
        ("bench", "wire"),
    ],
    ids=" ".join,
)
def test_results_that_cannot_be_printed_are_in_the_file(
    words: tuple[str, ...], giirl: Command, finished: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("benchmarks.farm.measure", lambda *_, **__: FOUND)
    monkeypatch.setattr("benchmarks.learner.measure", lambda *_, **__: {"learner": 1.0})
    monkeypatch.setattr("benchmarks.transport.BENCHES", dict.fromkeys(bench.TRANSPORT, lambda: {"seconds": 1.0}))
    enter_text_recording().write(tmp_path / "recordings/first/enter-text/a.json.gz")
    giirl(*(word.replace("RUN", str(finished)) for word in words), "--json", "a.json")
    assert json.loads((tmp_path / "a.json").read_text())
    assert "--out" not in words or read_episodes(tmp_path / "d.giirl")


# ---- one bad file among many recordings

LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
BAD = {  # what the report says of it: where it is, its content
    "truncated": ("first/enter-text/b.json.gz", gzip.compress(b"{" * 500)[:-5]),
    "an empty file": ("first/enter-text/b.json.gz", b""),
    "a pointer of Git LFS": ("first/enter-text/b.json.gz", LFS),
    "a companion file of macOS": ("first/enter-text/._a.json.gz", b"\0\5\x16\7" + bytes(99)),
    "not JSON": ("first/enter-text/b.json", b"hello"),
    "missing": ("index.json", b"{}"),
    "No such file": ("first/enter-text/b.json.gz", None),  # a link to nothing
}


@pytest.fixture
def recordings(tmp_path: Path) -> Path:
    """A collection with three sound recordings of enter-text."""
    for number, who in enumerate(["Ada", "Eve", "Kim"]):
        enter_text_recording(who).write(tmp_path / f"recordings/first/enter-text/{'acd'[number]}.json.gz")
    return tmp_path / "recordings"


@pytest.mark.parametrize("what", BAD)
def test_a_recording_that_cannot_be_read_is_named_and_the_others_are_imported(
    what: str, giirl: Command, recordings: Path, tmp_path: Path
) -> None:
    where, content = BAD[what]
    if content is None:
        (recordings / where).symlink_to("../annex/gone")
    else:
        (recordings / where).write_bytes(content)
    answer = giirl("demos", "import", "recordings", "--out", "d.giirl", "--json", "report.json")
    assert answer.status == 1
    assert "1 cannot be read, the first is" in answer.error
    assert "d.giirl has the others" in answer.error
    assert len(read_episodes(tmp_path / "d.giirl")) == 3
    assert "1 unreadable" in answer.out
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["clean"] == 3
    (line,) = [line for task in report["tasks"].values() for line in task["unreadable"]]
    assert what in line


def test_a_sound_copy_of_a_recording_replaces_one_that_cannot_be_read(
    giirl: Command, recordings: Path, tmp_path: Path
) -> None:
    shutil.copytree(recordings / "first", recordings / "second")
    (recordings / "first/enter-text/a.json.gz").write_bytes(b"")
    assert giirl("demos", "import", "recordings", "--out", "d.giirl").status == 1
    assert len(read_episodes(tmp_path / "d.giirl")) == 3


def test_training_uses_the_recordings_that_can_be_read_and_says_how_many_cannot(
    giirl: Command, recordings: Path
) -> None:
    (recordings / "first/enter-text/b.json.gz").write_bytes(LFS)
    words = (*SETTINGS, "iterations=1", 'tasks=["enter-text"]', "demos.source=recordings", "demos.path=recordings")
    answer = giirl("train", *words, "run=out")
    assert answer.status == 0, answer.err
    assert "recordings: 1 cannot be read, the first is" in answer.err
    assert json.loads(Path("out/result.json").read_text())["demonstrations"] == {"enter-text": 3}


# ---- one bad episode among many


@pytest.fixture
def demonstrations(finished: Path, tmp_path: Path) -> Path:
    """A copy of a run's 16 demonstrations."""
    return Path(shutil.copy(finished / "demonstrations.giirl", tmp_path / "d.giirl"))


def damage_one(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[data.index(b"click-button")] ^= 1
    file.write_bytes(data)


def cut_off(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-100])


@pytest.mark.parametrize("damage", [damage_one, cut_off])
def test_an_episode_file_with_a_fault_serves_with_its_other_episodes(
    damage: Callable[[Path], None], giirl: Command, finished: Path, demonstrations: Path, tmp_path: Path
) -> None:
    damage(demonstrations)
    train = ("demos.source=file", "demos.path=d.giirl", "iterations=1", "run=out")
    answer = giirl("train", *SETTINGS, *train)
    assert answer.status == 0, answer.err
    assert "d.giirl: 1 cannot be read, the first is episode" in answer.err
    assert sum(json.loads(Path("out/result.json").read_text())["demonstrations"].values()) == 15
    stats = giirl("demos", "stats", "nowhere.giirl", "d.giirl", finished / "demonstrations.giirl")
    assert "2 faults, the first: nowhere.giirl: No such file or directory" in stats.error
    assert stats.out.count("demonstrations.giirl") == 1
    scored = giirl("reward", "score", finished, "d.giirl", "--json", "a.json")
    assert "1 have no score, the first is episode" in scored.error
    assert len(json.loads((tmp_path / "a.json").read_text())["episodes"]) == 15


def test_a_demonstration_that_the_nets_cannot_learn_is_left_out_and_said(giirl: Command, demonstrations: Path) -> None:
    first, *others = read_episodes(demonstrations)
    hover = replace(first.trajectory.actions[0], verb=Verb.HOVER, start=NO_SPAN, end=NO_SPAN)
    actions = (hover, *first.trajectory.actions[1:])
    write_episodes(demonstrations, [replace(first, trajectory=replace(first.trajectory, actions=actions)), *others])
    answer = giirl("train", *SETTINGS, "iterations=1", "demos.source=file", "demos.path=d.giirl", "run=out")
    assert answer.status == 0, answer.err
    assert "1 demonstrations are left out, the first because" in answer.err
    assert "is HOVER" in answer.err


def test_a_study_that_fails_does_not_keep_the_others_from_being_done(tmp_path: Path) -> None:
    called: list[str] = []

    def study(name: str, error: Exception | None) -> click.Command:
        @click.command(name)
        @click.option("--json", "json_file")
        def command(json_file: str | None) -> None:
            called.append(name)
            if error is not None:
                raise error

        return command

    (everything,) = (command for command in commands() if command.name == "all")
    group = click.Group("reproduce", commands=[study("a", ValueError("no page")), study("b", None), everything])
    done = CliRunner().invoke(group, ["all", "--out", str(tmp_path)])
    assert called == ["a", "b"]
    assert str(done.exception) == "1 studies failed, the first is a: no page; the same command tries again"
