"""Checkpoints are whole or not there, and what is wrong with one is said in a line that tells how to go on."""

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


def test_only_the_newest_are_kept(tmp_path: Path) -> None:
    for step in range(1, 7):
        save(tmp_path, step, keep=2)
    assert steps(tmp_path) == [LATEST, "step-00000005", "step-00000006"]


@pytest.mark.parametrize("keep", [1, 2])
def test_after_going_back_the_new_checkpoint_outlives_the_later_ones(keep: int, tmp_path: Path) -> None:
    for step in (10, 20, 30):
        save(tmp_path, step)
    (tmp_path / LATEST).write_text("step-00000010")
    new = save(tmp_path, 11, keep=keep)
    assert latest_checkpoint(tmp_path) == new
    assert len(steps(tmp_path)) == 1 + keep


def test_a_step_saved_again_replaces_the_first(tmp_path: Path) -> None:
    save(tmp_path, 4, blob=b"old")
    save(tmp_path, 4, blob=b"new")
    assert (latest_checkpoint(tmp_path) / "net.safetensors").read_bytes() == b"new"


def test_a_step_saved_twice_is_never_without_a_whole_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = save(tmp_path, 4)
    rename, seen = Path.rename, []

    def watched(self: Path, target: Path) -> Path:
        seen.append(latest_checkpoint(tmp_path))
        renamed = rename(self, target)
        seen.append(latest_checkpoint(tmp_path))
        return renamed

    monkeypatch.setattr(Path, "rename", watched)
    second = save(tmp_path, 4)
    assert set(seen) == {first}
    assert save(tmp_path, 4) == first != second
    assert latest_checkpoint(tmp_path) == first


@pytest.mark.parametrize("step", [1, 2])
def test_a_crash_while_writing_leaves_the_older_one_the_latest(step: int, tmp_path: Path) -> None:
    older = save(tmp_path, 1)

    def crash(partial: Path) -> None:
        (partial / "net.safetensors").write_bytes(BLOB[:10])
        raise OSError("no space left on device")

    with pytest.raises(OSError, match="no space"):
        save_checkpoint(tmp_path, step, crash, keep=3)
    assert latest_checkpoint(tmp_path) == older
    save(tmp_path, 2)
    assert steps(tmp_path) == [LATEST, "step-00000001", "step-00000002"]


def truncate(found: Path) -> None:
    (found / "net.safetensors").write_bytes(BLOB[:100])


def flip(found: Path) -> None:
    (found / "net.safetensors").write_bytes(bytes([BLOB[0] ^ 1]) + BLOB[1:])


def remove(found: Path) -> None:
    (found / "net.safetensors").unlink()


def garble(found: Path) -> None:
    (found / MANIFEST).write_bytes(b"\xff\x00 no json")


def empty(found: Path) -> None:
    (found / MANIFEST).write_text("[]")


def rebuild(found: Path) -> None:
    (found / MANIFEST).write_text(json.dumps({"sha256": ["net.safetensors"]}))


def unlist(found: Path) -> None:
    (found / MANIFEST).unlink()


def lead_nowhere(found: Path) -> None:
    (found.parent / LATEST).write_text("step-00000009")


def lead_out(found: Path) -> None:
    (found.parent / LATEST).write_text("../elsewhere")


def lead_home(found: Path) -> None:
    (found.parent / LATEST).write_text("")


@pytest.mark.parametrize(
    ("harm", "named"),
    [
        (truncate, "net.safetensors, now 100 bytes"),
        (flip, "net.safetensors, now 200 bytes"),
        (remove, "net.safetensors is missing"),
        (garble, MANIFEST),
        (empty, MANIFEST),
        (rebuild, MANIFEST),
        (unlist, "step-00000002"),
        (lead_nowhere, "step-00000009"),
        (lead_out, "elsewhere"),
        (lead_home, LATEST),
    ],
)
def test_a_spoiled_checkpoint_is_one_line_that_says_what_and_how_to_mend_it(
    harm: Callable[[Path], None], named: str, tmp_path: Path
) -> None:
    save(tmp_path, 1)
    harm(save(tmp_path, 2))
    with pytest.raises(ValueError, match=named) as caught:
        latest_checkpoint(tmp_path)
    said = str(caught.value)
    assert "\n" not in said
    assert str(tmp_path) in said
    assert f"into {tmp_path / LATEST}" in said
    name = said.partition("write ")[2].split()[0]
    (tmp_path / LATEST).write_text(name)  # as it says
    if harm not in (lead_nowhere, lead_out, lead_home):
        assert name == "step-00000001"
    assert latest_checkpoint(tmp_path) == tmp_path / name


def test_a_spoiled_checkpoint_without_an_older_one_says_so(tmp_path: Path) -> None:
    flip(save(tmp_path, 1))
    with pytest.raises(ValueError, match="there is no older one"):
        latest_checkpoint(tmp_path)


def test_an_empty_folder_holds_no_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="holds no checkpoint to resume from"):
        latest_checkpoint(tmp_path)
