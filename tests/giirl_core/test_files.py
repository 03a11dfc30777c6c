"""Files are replaced as a whole or not at all."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import pytest

from giirl_core.files import short_temporary_folder, write_json
from giirl_core.temporary import OLD_S, user_folder


def test_json_is_written_with_a_final_newline(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": [1, 2.5, None]})
    text = (tmp_path / "a.json").read_text()
    assert json.loads(text) == {"a": [1, 2.5, None]}
    assert text.endswith("}\n")


def test_a_value_that_is_not_json_leaves_the_old_file_and_no_other(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"a": 1})
    with pytest.raises(TypeError):
        write_json(tmp_path / "a.json", {"a": object()})
    assert json.loads((tmp_path / "a.json").read_text()) == {"a": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_the_temporary_folder_belongs_to_the_unix_user_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = user_folder()
    assert folder == tmp_path / f"giirl-{os.getuid()}"
    assert folder.stat().st_mode & 0o777 == 0o700
    monkeypatch.setattr("os.getuid", lambda: 4242)
    (tmp_path / "giirl-4242").mkdir()
    with pytest.raises(ValueError, match="giirl-4242 belongs to user 0: remove it, or set TMPDIR"):
        user_folder()


def test_what_nothing_has_changed_for_a_week_is_deleted_from_the_temporary_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = user_folder()
    old_s = time.time() - OLD_S - 60
    for run, file_s in (("dead", old_s), ("under-way", time.time())):
        (folder / run).mkdir()
        (folder / run / "actor-0.count").write_text("")
        os.utime(folder / run / "actor-0.count", (file_s, file_s))
        os.utime(folder / run, (old_s, old_s))
    assert [path.name for path in user_folder().iterdir()] == ["under-way"]


def test_sockets_lie_in_the_folder_for_temporary_files_unless_its_path_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", "/var/tmp")
    assert short_temporary_folder() == "/var/tmp"
    assert short_temporary_folder("/scratch") == "/scratch"
    assert short_temporary_folder("/scratch/" + "x" * 72) == "/tmp"
    monkeypatch.setattr("tempfile.tempdir", "/scratch/" + "x" * 72)
    assert short_temporary_folder() == "/tmp"
