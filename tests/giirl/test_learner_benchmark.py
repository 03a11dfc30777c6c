"""`giirl bench learner --before` on commits whose interfaces differ from today's."""

from __future__ import annotations

from pathlib import Path

from benchmarks.learner import ROOT, run_turn

PROGRAM = """
import json
import sys

print(json.dumps({"arguments": sys.argv[1:], "path": sys.path}))
"""


def test_another_commit_is_measured_by_its_own_program_on_this_fixture(tmp_path: Path) -> None:
    program = tmp_path / "benchmarks" / "learner_parts.py"
    program.parent.mkdir()
    program.write_text(PROGRAM)

    found = run_turn("four", tmp_path)

    assert found["arguments"][0] == "four"
    assert found["arguments"][2] == str(ROOT / "benchmarks")
    assert str(tmp_path) in found["path"]


def test_the_fixture_needs_nothing_that_an_older_commit_may_lack() -> None:
    lines = (ROOT / "benchmarks" / "pages.py").read_text().splitlines()
    imported = [line for line in lines if line.startswith(("import giirl", "from giirl"))]
    assert [line.split()[1] for line in imported] == ["giirl_core.types"]
