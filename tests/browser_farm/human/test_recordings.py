"""Reading recordings: what no file may do to the reader, and that every file is accounted for."""

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

from browser_farm.human import recordings
from browser_farm.human.recordings import find_recordings, import_recordings, read_recording
from giirl_core.types import Trajectory
from tests.browser_farm.human.recording_pages import Tape, entered, form

# ---- what is no recording


def content() -> dict[str, Any]:
    return copy.deepcopy(entered().content())


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in content().items() if name != key}


BAD = {
    "nothing": b"",
    "prose": b"dear reader",
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
    "wordless": json.dumps(content() | {"utterance": "  "}).encode(),
    "no tag": json.dumps(content() | {"states": [{"action": None, "dom": {"ref": 1}}]}).encode(),
}


@pytest.mark.parametrize("raw", BAD.values(), ids=BAD.keys())
def test_what_is_no_recording_is_a_value_error_of_one_line_that_names_the_file(tmp_path: Path, raw: bytes) -> None:
    path = tmp_path / "task" / "bad.json.gz"
    path.parent.mkdir()
    path.write_bytes(raw)
    with pytest.raises(ValueError, match=r"bad\.json\.gz is no recording") as caught:
        read_recording(path)
    assert "\n" not in str(caught.value)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recordings, "MOST_BYTES", 1 << 20)
    path = tmp_path / "bomb.json.gz"
    path.write_bytes(gzip.compress(b" " * (8 << 20)))
    with pytest.raises(ValueError, match="more than 1 MB"):
        read_recording(path)


def test_a_file_that_is_not_there_is_a_value_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"gone\.json is no recording: cannot be read"):
        read_recording(tmp_path / "gone.json")


def test_plain_json_reads_like_packed(tmp_path: Path) -> None:
    plain = read_recording(entered().write(tmp_path / "t" / "a.json"))
    packed = read_recording(entered().write(tmp_path / "t" / "a.json.gz"))
    assert plain.episode is not None
    assert packed.episode is not None
    assert plain.episode.trajectory.seed == packed.episode.trajectory.seed
    for one, other in zip(plain.episode.trajectory.pages, packed.episode.trajectory.pages, strict=True):
        assert one.text == other.text
        assert np.array_equal(one.box, other.box)


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(place for key, below in items for place in places(below, (*at, key)))]


PLACES = places(content())[1:]
JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(), st.just([]), st.just({})
)


@settings(max_examples=200, deadline=None)
@given(place=st.sampled_from(PLACES), junk=JUNK)
def test_no_spoiled_recording_does_more_than_a_value_error(place: tuple[Any, ...], junk: Any) -> None:
    spoiled: Any = content()
    inner = spoiled
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = junk
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spoiled.json"
        path.write_text(json.dumps(spoiled))
        try:
            recorded = read_recording(path)
        except ValueError as error:
            said = str(error)
        else:
            said = f"{path} reads"
            assert recorded.clean == (recorded.reason == "")
            assert recorded.episode is not None or not recorded.clean
        assert said.startswith(str(path))


# ---- many recordings


def collection(root: Path) -> Path:
    for where, task, names in [
        ("first", "enter-text", ["Ada", "Eve"]),
        ("second", "enter-text", ["Kim", "Lea", "Ada"]),
        ("second", "enter-text-nodelay", ["Bo"]),
    ]:
        for name in names:
            entered(name).write(root / where / task / f"{task}_{name}_d1.json.gz")
    entered("Zoe").write(root / "second" / "enter-text" / "enter-text_Mo_d1.json.gz", raw_reward=-1)
    empty = Tape(form(), "Enter it.")
    empty.states = []
    empty.write(root / "second" / "enter-text" / "enter-text_Nil_d1.json.gz")
    return root


def named(root: Path, **wanted: Any) -> list[str]:
    episodes, _ = import_recordings(root, **wanted)
    return [episode.trajectory.goal.utterance.split('"')[1] for episode in episodes]


def test_recordings_come_in_the_order_of_collections_and_names_and_repeats_once(tmp_path: Path) -> None:
    assert named(collection(tmp_path), tasks=["enter-text"]) == ["Ada", "Eve", "Kim", "Lea", "Zoe"]


def test_every_file_is_accounted_for(tmp_path: Path) -> None:
    _, report = import_recordings(collection(tmp_path), tasks=["enter-text", "enter-text-nodelay"])
    count = report.tasks["enter-text"]
    assert (count.files, count.clean, count.failures, count.unread) == (7, 4, 1, 0)
    assert count.skipped == {"empty": 1, "repeated": 1}
    assert report.tasks["enter-text-nodelay"].clean == 1
    assert re.split(r"\s{2,}", report.lines()[1]) == ["enter-text", "7", "4", "1", "0", "1 empty, 1 repeated"]


def test_the_limit_counts_clean_recordings_and_leaves_the_rest_unread(tmp_path: Path) -> None:
    root = collection(tmp_path)
    assert named(root, tasks=["enter-text"], limit=3) == ["Ada", "Eve", "Kim"]
    _, report = import_recordings(root, tasks=["enter-text"], limit=3)
    assert (report.tasks["enter-text"].clean, report.tasks["enter-text"].unread) == (3, 3)


def test_one_collection_or_one_task_may_be_the_root(tmp_path: Path) -> None:
    root = collection(tmp_path)
    assert named(root / "first", tasks=["enter-text"]) == ["Ada", "Eve"]
    assert named(root / "first" / "enter-text", tasks=["enter-text"]) == ["Ada", "Eve"]
    assert named(root, tasks=["enter-text"], collections=["first"]) == ["Ada", "Eve"]


def test_an_unknown_task_names_the_nearest_there_is(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no recordings of 'enter-txt', wanted one of: enter-text, "):
        import_recordings(collection(tmp_path), tasks=["enter-txt"])


def test_an_unknown_collection_or_an_empty_folder_is_a_value_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no collection 'third', wanted one of: first, second"):
        import_recordings(collection(tmp_path), tasks=["enter-text"], collections=["third"])
    (tmp_path / "bare").mkdir()
    with pytest.raises(ValueError, match="has no recordings"):
        import_recordings(tmp_path / "bare", tasks=["enter-text"])
    with pytest.raises(ValueError, match="is no folder"):
        import_recordings(tmp_path / "nowhere", tasks=["enter-text"])
    with pytest.raises(ValueError, match="limit is 0"):
        import_recordings(tmp_path, tasks=["enter-text"], limit=0)


# ---- the public recordings, where they are at hand

PUBLIC = pytest.mark.skipif("GIIRL_DEMOS" not in os.environ, reason="GIIRL_DEMOS names no folder of public recordings")


def asked(trajectory: Trajectory) -> list[tuple[str, str, str, str]]:
    """What the instruction asks for: verb, tag, its words, what to type."""
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
def test_the_public_recordings_do_what_their_instructions_ask_in_every_file() -> None:
    root = Path(os.environ["GIIRL_DEMOS"])
    tasks = ["click-test", "click-test-2", "click-button", "focus-text", "enter-text", "enter-date", "enter-time"]
    episodes, report = import_recordings(root, tasks=tasks)
    for task, count in report.tasks.items():
        assert count.clean >= 28, task
        assert set(count.skipped) <= {"empty", "repeated"}, task
    for episode in episodes:
        trajectory = episode.trajectory
        assert episode.outcome.success
        assert asked(trajectory) == [
            (action.verb.name, page.tag[action.element], page.text[action.element], action.text(trajectory.goal))
            for page, action in zip(trajectory.pages, trajectory.actions, strict=True)
        ]


@PUBLIC
@pytest.mark.slow
@pytest.mark.timeout(300)
def test_nine_of_ten_recordings_of_the_second_collection_come_out_clean_and_none_is_unaccounted_for() -> None:
    root = Path(os.environ["GIIRL_DEMOS"])
    found = find_recordings(root, collections=["2017-10-16_second-turk"])
    episodes, report = import_recordings(root, tasks=list(found), collections=["2017-10-16_second-turk"])
    counts = report.tasks.values()
    assert all(count.files == count.clean + count.failures + sum(count.skipped.values()) for count in counts)
    assert sum(count.files for count in counts) == sum(map(len, found.values()))
    assert sum(count.clean for count in counts) >= 0.9 * sum(count.files for count in counts)
    assert len(episodes) == sum(count.clean + count.failures for count in counts)
