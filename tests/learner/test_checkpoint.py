"""Checkpoints are atomic, and the error for a damaged one says in one line how to resume from an older one."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from learner.checkpoint import LATEST, MANIFEST, latest_checkpoint, save_checkpoint

BLOB = bytes(range(200))


def save(folder: Path, step: int, keep: int = 3, blob: bytes = BLOB) -> Path:
    def write(partial: Path) -> None:
        (partial / "net.safetensors").write_bytes(blob)
        (partial / "state.json").write_text(str(step))

    return save_checkpoint(folder, step, write, keep)


def steps(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_latest_checkpoint_is_the_last_one_saved(tmp_path: Path) -> None:
    save(tmp_path, 1)
    newest = save(tmp_path, 2)
    assert latest_checkpoint(tmp_path) == newest
    assert (latest_checkpoint(tmp_path) / "net.safetensors").read_bytes() == BLOB


def test_only_the_newest_checkpoints_are_kept(tmp_path: Path) -> None:
    for step in range(1, 7):
        save(tmp_path, step, keep=2)
    assert steps(tmp_path) == [LATEST, "step-00000005", "step-00000006"]


@pytest.mark.parametrize("keep", [1, 2])
def test_after_resuming_from_an_earlier_step_the_new_checkpoint_outlives_the_later_ones(
    keep: int, tmp_path: Path
) -> None:
    for step in (10, 20, 30):
        save(tmp_path, step)
    (tmp_path / LATEST).write_text("step-00000010")
    new = save(tmp_path, 11, keep=keep)
    assert latest_checkpoint(tmp_path) == new
    assert len(steps(tmp_path)) == 1 + keep


def test_a_step_saved_again_replaces_the_first_save(tmp_path: Path) -> None:
    save(tmp_path, 4, blob=b"old")
    save(tmp_path, 4, blob=b"new")
    assert (latest_checkpoint(tmp_path) / "net.safetensors").read_bytes() == b"new"


def test_there_is_a_complete_checkpoint_at_every_moment_while_a_step_is_saved_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = save(tmp_path, 4)
    rename, latest = Path.rename, []

    def recorded(self: Path, target: Path) -> Path:
        latest.append(latest_checkpoint(tmp_path))
        renamed = rename(self, target)
        latest.append(latest_checkpoint(tmp_path))
        return renamed

    monkeypatch.setattr(Path, "rename", recorded)
    second = save(tmp_path, 4)
    assert set(latest) == {first}
    assert save(tmp_path, 4) == first != second
    assert latest_checkpoint(tmp_path) == first


@pytest.mark.parametrize("step", [1, 2])
def test_a_crash_while_writing_leaves_the_older_checkpoint_the_latest(step: int, tmp_path: Path) -> None:
    older = save(tmp_path, 1)

    def crash(partial: Path) -> None:
        (partial / "net.safetensors").write_bytes(BLOB[:10])
        raise OSError("no space left on device")

    with pytest.raises(OSError, match="no space"):
        save_checkpoint(tmp_path, step, crash, keep=3)
    assert latest_checkpoint(tmp_path) == older
    save(tmp_path, 2)
    assert steps(tmp_path) == [LATEST, "step-00000001", "step-00000002"]


def truncate_file(found: Path) -> None:
    (found / "net.safetensors").write_bytes(BLOB[:100])


def flip_bit(found: Path) -> None:
    (found / "net.safetensors").write_bytes(bytes([BLOB[0] ^ 1]) + BLOB[1:])


def remove_file(found: Path) -> None:
    (found / "net.safetensors").unlink()


def write_invalid_json(found: Path) -> None:
    (found / MANIFEST).write_bytes(b"\xff\x00 no json")


def write_empty_manifest(found: Path) -> None:
    (found / MANIFEST).write_text("[]")


def write_list_of_hashes(found: Path) -> None:
    (found / MANIFEST).write_text(json.dumps({"sha256": ["net.safetensors"]}))


def remove_manifest(found: Path) -> None:
    (found / MANIFEST).unlink()


def point_to_missing_folder(found: Path) -> None:
    (found.parent / LATEST).write_text("step-00000009")


def point_outside(found: Path) -> None:
    (found.parent / LATEST).write_text("../elsewhere")


def point_to_nothing(found: Path) -> None:
    (found.parent / LATEST).write_text("")


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (truncate_file, r"net.safetensors \(100 bytes\)"),
        (flip_bit, r"net.safetensors \(200 bytes\)"),
        (remove_file, "net.safetensors is missing"),
        (write_invalid_json, MANIFEST),
        (write_empty_manifest, MANIFEST),
        (write_list_of_hashes, MANIFEST),
        (remove_manifest, "step-00000002"),
        (point_to_missing_folder, "step-00000009"),
        (point_outside, "elsewhere"),
        (point_to_nothing, LATEST),
    ],
)
def test_a_damaged_checkpoint_is_reported_in_one_line_that_says_what_is_wrong_and_how_to_resume(
    damage: Callable[[Path], None], named: str, tmp_path: Path
) -> None:
    save(tmp_path, 1)
    damage(save(tmp_path, 2))
    with pytest.raises(ValueError, match=named) as caught:
        latest_checkpoint(tmp_path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(tmp_path) in message
    assert f"into {tmp_path / LATEST}" in message
    name = message.partition("write ")[2].split()[0]
    (tmp_path / LATEST).write_text(name)  # as the message says
    if damage not in (point_to_missing_folder, point_outside, point_to_nothing):
        assert name == "step-00000001"
    assert latest_checkpoint(tmp_path) == tmp_path / name


def test_the_error_for_a_damaged_checkpoint_says_when_there_is_no_older_one(tmp_path: Path) -> None:
    flip_bit(save(tmp_path, 1))
    with pytest.raises(ValueError, match="there is no older checkpoint"):
        latest_checkpoint(tmp_path)


def test_resuming_from_an_empty_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no checkpoint to resume from"):
        latest_checkpoint(tmp_path)
