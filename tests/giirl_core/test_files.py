"""Files are replaced as a whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from giirl_core.files import short_temporary_folder, write_json


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


def test_sockets_lie_in_the_folder_for_temporary_files_unless_its_path_is_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", "/var/tmp")
    assert short_temporary_folder() == "/var/tmp"
    assert short_temporary_folder("/scratch") == "/scratch"
    assert short_temporary_folder("/scratch/" + "x" * 72) == "/tmp"
    monkeypatch.setattr("tempfile.tempdir", "/scratch/" + "x" * 72)
    assert short_temporary_folder() == "/tmp"
