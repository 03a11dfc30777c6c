"""Runs that are killed at random moments go on, with the same command or with the one that its message names."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent.parent


@pytest.mark.timeout(900)  # on a busy machine; half a minute for each ten kills on an idle one
def test_a_run_that_is_killed_at_random_moments_goes_on_to_the_same_parameters(full: bool, tmp_path: Path) -> None:
    kills, seed = (50, 2) if full else (3, 1)
    command = [sys.executable, "-m", "tests.faults.kills", str(tmp_path), str(kills), str(seed)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stderr
    tally = json.loads((tmp_path / "result.json").read_text())
    assert tally["stuck"] == []
    assert tally["lost"] == []
    assert tally["kills"] == kills
    assert set(tally["ended"]) == {tally["straight"]}
