"""Text: TOML and JSON are UTF-8 in every locale, ~ is the home folder, and no number is cut in a table."""

from __future__ import annotations

import ast
import io
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from rich.table import Table

from giirl_core.config_file import dump_config, load_config
from giirl_core.progress import Display
from tests.command import Command
from tests.giirl.small import SETTINGS
from tests.test_frame import PACKAGES, name, sources

TEXT_MODES = {"r", "w", "a", "x", "r+", "w+", "a+", "rt", "wt"}


def in_the_locale_of_the_machine(path: Path) -> list[str]:
    """Where a file of code reads or writes text without saying that it is UTF-8."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if not isinstance(node, ast.Call) or "encoding" in {keyword.arg for keyword in node.keywords}:
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        modes = {argument.value for argument in node.args if isinstance(argument, ast.Constant)}
        if called in ("read_text", "write_text") or (called == "open" and modes & TEXT_MODES):
            found.append(f"{path.name}:{node.lineno}")
    return found


def test_all_code_says_that_its_text_files_are_utf_8() -> None:
    assert {name(path): found for path in sources(*PACKAGES) if (found := in_the_locale_of_the_machine(path))} == {}


@pytest.mark.parametrize("line", ["p.read_text()", "p.write_text(t)", "open(p, 'w')", "p.open('a')"])
def test_text_in_the_locale_of_the_machine_is_found_in_each_of_its_forms(line: str, tmp_path: Path) -> None:
    (tmp_path / "guilty.py").write_text(line)
    assert in_the_locale_of_the_machine(tmp_path / "guilty.py") == ["guilty.py:1"]


CONFIG = '# Größe, 大きさ\nseed = 3\ndemos.path = "/tmp/Größe/大きさ"\n'


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"], ids=["", "with a byte order mark"])
def test_a_config_is_utf_8_in_a_locale_that_is_not(mark: bytes, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_bytes(mark + CONFIG.encode())
    code = (
        "import pathlib; from giirl_core.config_file import dump_config, load_config\n"
        "config = load_config(pathlib.Path('mine.toml'))\n"
        "pathlib.Path('again.json').write_bytes(dump_config(config).encode())\n"
        "assert load_config(pathlib.Path('again.json')) == config\n"
    )
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONPATH": str(Path.cwd())}
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env={**os.environ, **ascii_only}, capture_output=True, timeout=60
    )
    assert done.returncode == 0, done.stderr.decode()
    assert json.loads((tmp_path / "again.json").read_bytes())["demos"]["path"] == "/tmp/Größe/大きさ"


def test_a_terminal_that_lacks_a_letter_does_not_end_a_command(giirl: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="ascii") for _ in range(2))
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stdout", out)
        patch.setattr(sys, "stderr", err)
        answer = giirl("demos", "make", "--browser", "fake", "--per-task", "1", "--out", "größe")
        out.flush()
        assert answer.status == 0
        assert rb"gr\xf6\xdfe" in out.buffer.getvalue()


def test_the_home_folder_is_found_in_settings_and_options(
    giirl: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert giirl("demos", "make", "--browser", "fake", "--out", "~/d.giirl").status == 0
    words = (*SETTINGS, "iterations=1", "demos.source=file", "demos.path=~/d.giirl", "run=~/out")
    Path("mine.toml").write_text("seed = 1")
    shutil.move("mine.toml", tmp_path / "home")
    assert giirl("train", "~/mine.toml", *words, "--json", "~/a.json").status == 0
    assert giirl("evaluate", "~/out").status == 0
    assert {path.name for path in (tmp_path / "home").iterdir()} == {"d.giirl", "out", "mine.toml", "a.json"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["home"]
    saved = json.loads((tmp_path / "home/out/config.json").read_text())
    assert saved["demos"]["path"] == str(tmp_path / "home/d.giirl")


def test_a_path_with_a_user_who_does_not_exist_stays_as_it_is() -> None:
    config = load_config(None, ["demos.path=~no-such-user/x", "reward_from=~/r", "algorithm=frozen"])
    assert config.demos.path == "~no-such-user/x"
    assert config.reward_from == str(Path.home() / "r")
    assert load_config(None, ["algorithm=frozen", f"reward_from={config.reward_from}"]).reward_from in dump_config(
        config
    )


def results() -> Table:
    table = Table(title="greedy success")
    for title, side in (("task", "left"), ("random", "right"), ("95 %", "right"), ("verbs", "left")):
        table.add_column(title, justify=side)  # type: ignore[arg-type]
    table.add_row("click-checkboxes-transfer", "100.0", "99.9 - 100.0", "click 123456, type 234567, drag 345678")
    return table


NUMBERS = ("click-checkboxes-transfer", "100.0", "99.9 - 100.0", "123456", "234567", "345678")


@pytest.mark.parametrize("columns", [10, 40, 80, 200])
@pytest.mark.parametrize("terminal", [True, False], ids=["terminal", "file"])
def test_no_number_of_a_table_is_cut(
    columns: int, terminal: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: terminal)
    Display().table(results())
    text = capsys.readouterr().out
    assert "…" not in text
    for number in NUMBERS:
        assert number in text


def test_a_table_that_is_too_wide_for_a_terminal_becomes_a_list_of_short_lines(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    Display().table(results())
    lines = capsys.readouterr().out.splitlines()
    assert lines[1:4] == ["task click-checkboxes-transfer", "  random 100.0", "  95 % 99.9 - 100.0"]


@pytest.mark.parametrize("columns", [40, 60, 80])
def test_a_progress_bar_shows_how_much_is_done_on_a_narrow_terminal(
    columns: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with Display().job("training", 300, 128) as job:
        job.advance(1, "success 100 100 99 100 %; 31.2 episodes/s, waiting 12 %")
    assert "129/300" in capsys.readouterr().err
