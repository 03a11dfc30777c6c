"""Reading recordings: invalid files are one-line errors, and the report counts every file."""

from __future__ import annotations

import copy
import gzip
import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from browser_farm.human import recording_files
from browser_farm.human.recording_files import find_recordings
from browser_farm.human.recordings import import_recordings, read_recording
from giirl_core.types import Trajectory
from tests.browser_farm.human.recording_builder import RecordingBuilder, enter_text_page, enter_text_recording

# ---- invalid files


def content() -> dict[str, Any]:
    return copy.deepcopy(enter_text_recording().content())


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in content().items() if name != key}


BAD = {
    "empty file": b"",
    "not json": b"dear reader",
    "latin": b'{"utterance": "\xe9"}',
    "list": b"[]",
    "nan": json.dumps(content() | {"rawReward": float("nan")}).encode(),
    "huge number": json.dumps(content() | {"rawReward": 10**400}).encode(),
    "deep": b'{"states": ' + b"[" * 200_000,
    "short gzip": gzip.compress(json.dumps(content()).encode())[:-20],
    "damaged gzip": gzip.compress(b"x" * 500)[:12] + b"\xff" * 40,
    "no utterance": json.dumps(without("utterance")).encode(),
    "no states": json.dumps(without("states")).encode(),
    "no reward": json.dumps(without("rawReward")).encode(),
    "states no list": json.dumps(content() | {"states": {}}).encode(),
    "state no object": json.dumps(content() | {"states": [1]}).encode(),
    "no words": json.dumps(content() | {"utterance": "  "}).encode(),
    "no tag": json.dumps(content() | {"states": [{"action": None, "dom": {"ref": 1}}]}).encode(),
}


@pytest.mark.parametrize("raw", BAD.values(), ids=BAD.keys())
def test_an_invalid_file_is_a_value_error_of_one_line_that_names_the_file(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "task" / "bad.json.gz"
    path.parent.mkdir()
    path.write_bytes(raw)
    with pytest.raises(ValueError, match=r"bad\.json\.gz is not a recording") as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)


def test_a_gzip_bomb_is_refused_before_it_is_decompressed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording_files, "MAX_BYTES", 1 << 20)
    path = tmp_path / "bomb.json.gz"
    path.write_bytes(gzip.compress(b" " * (8 << 20)))
    with pytest.raises(ValueError, match="more than 1 MB"):
        read_recording(path)


def test_a_missing_file_is_a_value_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone\.json is not a recording: cannot be read"):
        read_recording(tmp_path / "gone.json")


def test_plain_json_is_read_like_compressed_json(tmp_path: Path) -> None:
    plain = read_recording(enter_text_recording().write(tmp_path / "t" / "a.json"))
    compressed = read_recording(enter_text_recording().write(tmp_path / "t" / "a.json.gz"))
    assert plain.episode is not None
    assert compressed.episode is not None
    assert plain.episode.trajectory.seed == compressed.episode.trajectory.seed
    for one, other in zip(plain.episode.trajectory.pages, compressed.episode.trajectory.pages, strict=True):
        assert one.text == other.text
        assert np.array_equal(one.box, other.box)


def key_paths(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(path for key, below in items for path in key_paths(below, (*at, key)))]


KEY_PATHS = key_paths(content())[1:]
JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(), st.just([]), st.just({})
)


@settings(max_examples=200, deadline=None)
@given(keys=st.sampled_from(KEY_PATHS), junk=JUNK)
def test_a_corrupted_recording_raises_nothing_but_value_error(keys: tuple[Any, ...], junk: Any) -> None:
    corrupted: Any = content()
    inner = corrupted
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = junk
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "corrupted.json"
        path.write_text(json.dumps(corrupted))
        try:
            imported = read_recording(path)
        except ValueError as error:
            message = str(error)
        else:
            message = ""
            assert imported.clean == (imported.reason == "")
            assert imported.episode is not None or not imported.clean
        assert not message or message.startswith(f"{path} is not a recording")


# ---- many recordings


def collection(root: Path) -> Path:
    for where, task, names in [
        ("first", "enter-text", ["Ada", "Eve"]),
        ("second", "enter-text", ["Kim", "Lea", "Ada"]),
        ("second", "enter-text-nodelay", ["Bo"]),
    ]:
        for name in names:
            enter_text_recording(name).write(root / where / task / f"{task}_{name}_d1.json.gz")
    enter_text_recording("Zoe").write(root / "second" / "enter-text" / "enter-text_Mo_d1.json.gz", raw_reward=-1)
    empty = RecordingBuilder(enter_text_page(), "Enter it.")
    empty.states = []
    empty.write(root / "second" / "enter-text" / "enter-text_Nil_d1.json.gz")
    return root


def names_in(root: Path, **wanted: Any) -> list[str]:
    episodes, _ = import_recordings(root, **wanted)
    return [episode.trajectory.goal.utterance.split('"')[1] for episode in episodes]


def test_recordings_are_sorted_by_collection_and_name_without_duplicates(tmp_path: Path) -> None:
    assert names_in(collection(tmp_path), tasks=["enter-text"]) == ["Ada", "Eve", "Kim", "Lea", "Zoe"]


def test_the_report_counts_every_file(tmp_path: Path) -> None:
    _, report = import_recordings(collection(tmp_path), tasks=["enter-text", "enter-text-nodelay"])
    count = report.tasks["enter-text"]
    assert (count.files, count.clean, count.failures, count.unread) == (7, 4, 1, 0)
    assert count.skipped == {"empty": 1, "duplicate": 1}
    assert report.tasks["enter-text-nodelay"].clean == 1
    assert re.split(r"\s{2,}", report.lines()[1]) == ["enter-text", "7", "4", "1", "0", "1 duplicate, 1 empty"]


def test_the_limit_counts_clean_recordings_and_leaves_the_rest_unread(tmp_path: Path) -> None:
    root = collection(tmp_path)
    assert names_in(root, tasks=["enter-text"], limit=3) == ["Ada", "Eve", "Kim"]
    _, report = import_recordings(root, tasks=["enter-text"], limit=3)
    assert (report.tasks["enter-text"].clean, report.tasks["enter-text"].unread) == (3, 3)


def test_one_collection_or_one_task_may_be_the_root(tmp_path: Path) -> None:
    root = collection(tmp_path)
    assert names_in(root / "first", tasks=["enter-text"]) == ["Ada", "Eve"]
    assert names_in(root / "first" / "enter-text", tasks=["enter-text"]) == ["Ada", "Eve"]
    assert names_in(root, tasks=["enter-text"], collections=["first"]) == ["Ada", "Eve"]


def test_the_error_for_an_unknown_task_names_the_nearest_tasks(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no recordings of 'enter-txt', wanted one of: enter-text, "):
        import_recordings(collection(tmp_path), tasks=["enter-txt"])


def test_an_unknown_collection_or_an_empty_folder_is_a_value_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no collection 'third', wanted one of: first, second"):
        import_recordings(collection(tmp_path), tasks=["enter-text"], collections=["third"])
    (tmp_path / "bare").mkdir()
    with pytest.raises(ValueError, match="has no recordings"):
        import_recordings(tmp_path / "bare", tasks=["enter-text"])
    with pytest.raises(ValueError, match="is not a folder"):
        import_recordings(tmp_path / "nowhere", tasks=["enter-text"])
    with pytest.raises(ValueError, match="limit is 0"):
        import_recordings(tmp_path, tasks=["enter-text"], limit=0)


# ---- the public recordings, if available

PUBLIC = pytest.mark.skipif(
    "GIIRL_DEMOS" not in os.environ, reason="GIIRL_DEMOS, the folder of public recordings, is not set"
)


def wanted_actions(trajectory: Trajectory) -> list[tuple[str, str, str, str]]:
    """The actions that the instruction asks for: verb, tag, text of the element, text to type."""
    quoted = re.findall('"(.*?)"', trajectory.goal.utterance)
    dates = re.findall(r"\d+/\d+/\d+", trajectory.goal.utterance)
    times = re.findall(r"\d+:\d+(?: [AP]M)?", trajectory.goal.utterance)
    return {
        "click-test": [("CLICK", "button", "Click Me!", "")],
        "click-test-2": [("CLICK", "button", "ONE", "")],
        "click-button": [("CLICK", "button", *quoted, "")],
        "focus-text": [("CLICK", "input_text", "", "")],
        "enter-text": [("TYPE", "input_text", "", *quoted), ("CLICK", "button", "Submit", "")],
        "enter-date": [("TYPE", "input_date", "", *dates), ("CLICK", "button", "Submit", "")],
        "enter-time": [("TYPE", "input_time", "", *times), ("CLICK", "button", "Submit", "")],
    }[trajectory.task]


@PUBLIC
def test_the_actions_of_the_public_recordings_are_those_that_the_instructions_ask_for() -> None:
    root = Path(os.environ["GIIRL_DEMOS"])
    tasks = ["click-test", "click-test-2", "click-button", "focus-text", "enter-text", "enter-date", "enter-time"]
    episodes, report = import_recordings(root, tasks=tasks)
    for task, count in report.tasks.items():
        assert count.clean >= 28, task
        assert set(count.skipped) <= {"empty", "duplicate"}, task
    for episode in episodes:
        trajectory = episode.trajectory
        assert episode.outcome.success
        assert wanted_actions(trajectory) == [
            (action.verb.name, page.tag[action.element], page.text[action.element], action.text(trajectory.goal))
            for page, action in zip(trajectory.pages, trajectory.actions, strict=True)
        ]


@PUBLIC
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nine_of_ten_recordings_of_the_second_collection_are_clean_and_all_are_counted() -> None:
    root = Path(os.environ["GIIRL_DEMOS"])
    found = find_recordings(root, collections=["2017-10-16_second-turk"])
    episodes, report = import_recordings(root, tasks=list(found), collections=["2017-10-16_second-turk"])
    counts = report.tasks.values()
    assert all(count.files == count.clean + count.failures + sum(count.skipped.values()) for count in counts)
    assert sum(count.files for count in counts) == sum(map(len, found.values()))
    assert sum(count.clean for count in counts) >= 0.9 * sum(count.files for count in counts)
    assert len(episodes) == sum(count.clean + count.failures for count in counts)
